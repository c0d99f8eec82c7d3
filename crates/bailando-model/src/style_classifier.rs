//! The style of a song, from statistics of its music features.

use ndarray::ArrayView2;
use serde::{Deserialize, Serialize};

use super::song_statistics::{STATISTICS, song_statistics};

/// File of a model directory that holds its classifier.
pub const STYLES_FILE: &str = "styles.json";

/// A linear classifier of songs: multinomial logistic regression on [`song_statistics`].
///
/// It was trained on songs of known styles, and answers only where a song is like these and one
/// style is far likelier than the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StyleClassifier {
    /// Names of the styles.
    pub styles: Vec<String>,
    /// Mean of each statistic over the training songs.
    pub mean: Vec<f32>,
    /// Its spread; above 0.
    pub spread: Vec<f32>,
    /// Weights of the standardised statistics, one list a style.
    pub weights: Vec<Vec<f32>>,
    /// Bias of each style.
    pub bias: Vec<f32>,
    /// Least probability of a style that is named.
    pub least: f32,
    /// Root mean square of the standardised statistics beyond which a song is like none of the
    /// training's.
    pub farthest: f32,
}

impl StyleClassifier {
    /// Standardises statistics.
    #[must_use]
    pub fn standardised(&self, statistics: &[f32]) -> Vec<f32> {
        let scale = self.mean.iter().zip(&self.spread);
        statistics
            .iter()
            .zip(scale)
            .map(|(value, (mean, spread))| (value - mean) / spread)
            .collect()
    }

    /// Returns the probability of each style for standardised statistics.
    #[must_use]
    pub fn probabilities(&self, standardised: &[f32]) -> Vec<f32> {
        let logits = self.weights.iter().zip(&self.bias).map(|(weights, bias)| {
            let products = weights.iter().zip(standardised);
            bias + products.map(|(weight, value)| weight * value).sum::<f32>()
        });
        let logits: Vec<f32> = logits.collect();
        let highest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let shares: Vec<f32> = logits.iter().map(|logit| (logit - highest).exp()).collect();
        let total: f32 = shares.iter().sum();
        shares.into_iter().map(|share| share / total).collect()
    }

    /// Returns the place of a song's style by its feature rows `[rows, 438 or more]`; `None` where
    /// it is like none of the training's songs, or of no style clearly.
    #[must_use]
    pub fn style(&self, rows: ArrayView2<'_, f32>) -> Option<usize> {
        self.of_statistics(&song_statistics(rows))
    }

    /// [`StyleClassifier::style`] by the song's statistics.
    #[must_use]
    pub fn of_statistics(&self, statistics: &[f32]) -> Option<usize> {
        let standardised = self.standardised(statistics);
        if root_mean_square(&standardised) > self.farthest {
            return None;
        }
        let probabilities = self.probabilities(&standardised).into_iter().enumerate();
        let best = probabilities.max_by(|(_, one), (_, other)| one.total_cmp(other));
        best.filter(|&(_, share)| share >= self.least).map(|(style, _)| style)
    }

    /// Checks that it fits a model of these styles.
    pub(super) fn validate(&self, styles: &[String]) -> Result<(), String> {
        if self.styles != styles {
            return Err("its styles are not the manifest's".into());
        }
        let count = self.styles.len();
        let lists = [&self.mean, &self.spread];
        let lists = lists.into_iter().chain(&self.weights);
        if self.weights.len() != count || self.bias.len() != count {
            return Err(format!("it does not have {count} lists of weights and biases"));
        }
        if lists.clone().any(|list| list.len() != STATISTICS) {
            return Err(format!("a list does not have {STATISTICS} numbers"));
        }
        let finite = lists.flatten().chain(&self.bias).all(|number| number.is_finite());
        if !finite || self.spread.iter().any(|&spread| spread <= 0.0) {
            return Err("a number is not finite, or a spread not above 0".into());
        }
        Ok(())
    }
}

/// Returns the root mean square of numbers.
#[must_use]
pub fn root_mean_square(numbers: &[f32]) -> f32 {
    let squares: f32 = numbers.iter().map(|number| number * number).sum();
    (squares / numbers.len().max(1) as f32).sqrt()
}

#[cfg(test)]
mod tests {
    use bailando_features::COLUMNS;
    use ndarray::Array2;

    use super::*;

    /// Knows a loud style by the mean of column 0 (the first MFCC), and a quiet one.
    fn classifier() -> StyleClassifier {
        let weights = |weight: f32| {
            let mut weights = vec![0.0; STATISTICS];
            weights[0] = weight;
            weights
        };
        StyleClassifier {
            styles: vec!["loud".into(), "quiet".into()],
            mean: vec![1.0; STATISTICS],
            spread: vec![2.0; STATISTICS],
            weights: vec![weights(4.0), weights(-4.0)],
            bias: vec![0.0, 0.0],
            least: 0.6,
            farthest: 3.0,
        }
    }

    fn song(first: f32, others: f32) -> Array2<f32> {
        Array2::from_shape_fn((4, COLUMNS + 2), |(row, column)| {
            let spread = if row % 2 == 0 { 1.0 } else { -1.0 };
            spread + if column == 0 { first } else { others }
        })
    }

    #[test]
    fn a_style_is_named_where_it_is_clear_and_the_song_like_others() {
        let style = |first, others| classifier().style(song(first, others).view());
        assert_eq!([style(3.0, 1.0), style(-1.0, 1.0)], [Some(0), Some(1)]);
        assert_eq!(style(1.02, 1.0), None, "as likely as the other");
        assert_eq!(style(3.0, 90.0), None, "like no song of the training");
        let shares = classifier().probabilities(&classifier().standardised(&[2.0]));
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-6 && shares[0] > 0.98);
    }

    #[test]
    fn one_that_does_not_fit_is_refused() {
        let styles = classifier().styles;
        let refused = |change: fn(&mut StyleClassifier)| {
            let mut classifier = classifier();
            change(&mut classifier);
            classifier.validate(&styles).unwrap_err()
        };
        assert_eq!(classifier().validate(&styles), Ok(()));
        assert!(refused(|it| it.styles.reverse()).contains("not the manifest's"));
        assert!(refused(|it| it.bias.truncate(1)).contains("weights and biases"));
        assert!(refused(|it| it.weights[1].truncate(154)).contains("155 numbers"));
        assert!(refused(|it| it.spread[3] = 0.0).contains("not above 0"));
        assert!(refused(|it| it.weights[0][0] = f32::NAN).contains("finite"));
    }
}
