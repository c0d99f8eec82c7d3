//! The styles of training recordings, and which of them a motion looks like.

use std::collections::BTreeMap;

use super::{
    discriminant::Discriminant,
    window::{COLUMNS, mirrored, windows},
};
use crate::{body::Pose, error::EvaluationError};

/// Knows styles by training recordings.
#[derive(Clone, Debug)]
pub(crate) struct StyleRecognition {
    styles: Vec<String>,
    discriminant: Discriminant,
}

impl StyleRecognition {
    /// Learns from recordings and their styles, each as it is and mirrored.
    ///
    /// # Errors
    /// [`EvaluationError::Option`] with fewer than two styles that have a window of 8 s.
    pub(crate) fn new<'a>(
        recordings: impl IntoIterator<Item = (&'a str, &'a [Pose])>,
    ) -> Result<Self, EvaluationError> {
        let mut classes: BTreeMap<&str, Vec<[f64; COLUMNS]>> = BTreeMap::new();
        for (style, poses) in recordings {
            let rows = classes.entry(style).or_default();
            rows.extend(windows(poses));
            rows.extend(windows(&mirrored(poses)));
        }
        classes.retain(|_, rows| !rows.is_empty());
        if classes.len() < 2 {
            let names: Vec<&str> = classes.into_keys().collect();
            return Err(EvaluationError::Option(format!(
                "styles are told apart where there are two at least with training recordings of \
                 8 s; found: [{}]",
                names.join(", ")
            )));
        }
        let styles = classes.keys().map(|&style| style.to_owned()).collect();
        let rows: Vec<Vec<[f64; COLUMNS]>> = classes.into_values().collect();
        Ok(Self { styles, discriminant: Discriminant::new(&rows) })
    }

    /// Counts the windows of a motion that look like `style`, and all; none where it does not know
    /// the style.
    pub(crate) fn recognised(&self, style: &str, poses: &[Pose]) -> Option<(usize, usize)> {
        let style = self.styles.iter().position(|known| known == style)?;
        let windows = windows(poses);
        let like = windows.iter().filter(|window| self.discriminant.classify(window) == style);
        Some((like.count(), windows.len()))
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// Sways at some pace, widely or not.
    fn sway(pace: f64, width: f64, seconds: usize) -> Vec<Pose> {
        let pose = |frame: usize| {
            let phase = frame as f64 / 60.0 * pace;
            std::array::from_fn(|joint| {
                let own = joint as f64;
                let x = own.sin() + width * (phase + own).sin();
                DVec3::new(x, 1.0 + own.cos(), 0.1 * (phase * 0.7).cos())
            })
        };
        (0..seconds * 60).map(pose).collect()
    }

    #[test]
    fn paces_are_recognised_in_motions_that_were_not_learned() {
        let [slow, slower] = [sway(2.0, 0.3, 30), sway(1.8, 0.25, 30)];
        let [fast, faster] = [sway(6.0, 0.3, 30), sway(7.0, 0.4, 30)];
        let takes = [("slow", &slow), ("slow", &slower), ("fast", &fast), ("fast", &faster)];
        let takes = takes.map(|(style, poses)| (style, poses.as_slice()));
        let recognition = StyleRecognition::new(takes).unwrap();
        let new = sway(6.4, 0.33, 20);
        assert_eq!(recognition.recognised("fast", &new), Some((7, 7)));
        assert_eq!(recognition.recognised("slow", &new), Some((0, 7)));
        assert_eq!(recognition.recognised("waltz", &new), None);
        assert_eq!(recognition.recognised("slow", &new[..400]), Some((0, 0)));
    }

    #[test]
    fn one_style_is_not_enough() {
        let (long, short) = (sway(2.0, 0.3, 20), sway(6.0, 0.3, 7));
        let error = StyleRecognition::new([("slow", &long[..]), ("fast", &short[..])]);
        let words = error.unwrap_err().to_string();
        assert!(words.contains("8 s") && words.ends_with("[slow]"), "{words}");
    }
}
