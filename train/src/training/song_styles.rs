//! The classifier of songs by style, learned from the features of the training songs.

use std::{
    collections::BTreeMap,
    fmt, fs,
    io::Write,
    path::{Path, PathBuf},
    sync::Arc,
};

use bailando::model::{STYLES_FILE, StyleClassifier, root_mean_square, song_statistics};
use ndarray::{Array1, Array2, Axis, Slice};
use serde::Serialize;

use super::{
    config::{Config, DataConfig},
    error::TrainError,
    files::{if_present, replace_file},
    input::style_names,
    songs::song_rows,
};
use crate::data::{DataError, Dataset, MusicSource, Portion, SplitKind};

/// Rows of an excerpt: ten seconds. People send parts of songs, too.
const EXCERPT: usize = 75;
/// Steps of the descent, and the weight of the squared weights.
const STEPS: usize = 400;
const DECAY: f32 = 0.02;
/// Smallest spread of a statistic: what hardly varies is not amplified further.
const SMALLEST_SPREAD: f32 = 1e-3;
/// Least probability of a style that is named.
const LEAST: f32 = 0.5;
/// A song may be this many times further from the mean than any excerpt of the training.
const ROOM: f32 = 1.5;

/// Songs of each style and what they were taken for, by a classifier.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StyleReport {
    /// Names of the styles.
    pub styles: Vec<String>,
    /// Songs that it learned from.
    pub training_songs: usize,
    /// Songs of the test split: a row for each style, a column for each style and one for `mixed`.
    pub confusion: Vec<Vec<usize>>,
    /// Share of the test songs whose style is found; none without test songs.
    pub accuracy: Option<f64>,
}

impl fmt::Display for StyleReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "| songs of | {} | mixed |", self.styles.join(" | "))?;
        writeln!(f, "|---|{}", "---|".repeat(self.styles.len() + 1))?;
        for (style, row) in self.styles.iter().zip(&self.confusion) {
            let counts: Vec<String> = row.iter().map(usize::to_string).collect();
            writeln!(f, "| {style} | {} |", counts.join(" | "))?;
        }
        let tested: usize = self.confusion.iter().flatten().sum();
        let trained = self.training_songs;
        match self.accuracy {
            Some(accuracy) => writeln!(
                f,
                "\n{trained} training songs; of {tested} test songs {:.1} % are found.",
                100.0 * accuracy
            ),
            None => writeln!(f, "\n{trained} training songs, no test songs."),
        }
    }
}

/// Returns the place of a run's classifier.
fn classifier_path(config: &Config) -> PathBuf {
    config.run.folder.join(STYLES_FILE)
}

/// Reads the classifier of a run, where it has one of these styles.
pub(super) fn read_classifier(
    config: &Config,
    styles: &[String],
) -> Result<Option<StyleClassifier>, TrainError> {
    let path = classifier_path(config);
    let Some(bytes) = if_present(fs::read(&path)).map_err(TrainError::file(&path))? else {
        return Ok(None);
    };
    let classifier: StyleClassifier = serde_json::from_slice(&bytes)
        .map_err(|error| TrainError::state(&path)(error.to_string()))?;
    Ok(Some(classifier).filter(|classifier| !styles.is_empty() && classifier.styles == styles))
}

/// Learns the classifier of a run from its training songs, writes it into the run's folder, from
/// where exports take it, and measures it on the test songs.
///
/// # Errors
/// [`TrainError::Data`] where no training song has a style; what cannot be read or written.
pub fn learn_styles(config: &Config, output: &mut impl Write) -> Result<StyleReport, TrainError> {
    let data = &config.data;
    let folders = data.all_folders();
    let dataset = Dataset::open_all(&folders, &data.open_options())?;
    let training = dataset.training()?;
    let styles = style_names(&training);
    let (examples, training_songs) = examples(data, &training, &styles, true, output)?;
    if examples.is_empty() {
        let message = "no training motion has a style and a song".into();
        return Err(TrainError::Data { path: folders[0].path.clone(), message });
    }
    let classifier = fit(&styles, &examples);
    write(&classifier_path(config), &classifier)?;
    let tests = match dataset.evaluation() {
        Err(DataError::Empty { .. }) => Vec::new(),
        test => self::examples(data, &test?, &styles, false, output)?.0,
    };
    let mut confusion = vec![vec![0; styles.len() + 1]; styles.len()];
    for (statistics, style) in &tests {
        let found = classifier.of_statistics(statistics).unwrap_or(styles.len());
        confusion[*style][found] += 1;
    }
    let right: usize = (0..styles.len()).map(|style| confusion[style][style]).sum();
    let accuracy = (!tests.is_empty()).then(|| right as f64 / tests.len() as f64);
    Ok(StyleReport { styles, training_songs, confusion, accuracy })
}

fn write(path: &Path, classifier: &StyleClassifier) -> Result<(), TrainError> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(TrainError::file(folder))?;
    }
    let text = serde_json::to_vec(classifier);
    let text = text.map_err(|error| TrainError::state(path)(error.to_string()))?;
    replace_file(path, &text).map_err(TrainError::file(path))
}

/// Statistics of a song or an excerpt, and its style.
type Example = (Vec<f32>, usize);

/// Returns the examples of a split's songs, with excerpts where these are wanted, and the number of
/// songs.
fn examples<S: SplitKind>(
    data: &DataConfig,
    portion: &Portion<S>,
    styles: &[String],
    excerpts: bool,
    output: &mut impl Write,
) -> Result<(Vec<Example>, usize), TrainError> {
    let mut songs: BTreeMap<MusicSource, usize> = BTreeMap::new();
    for dance in portion.recordings() {
        let style = dance.marks().style.as_ref();
        let Some(style) = styles.iter().position(|known| Some(known) == style) else { continue };
        let music = dance.songs().iter().filter_map(|song| song.music.clone());
        songs.extend(music.map(|music| (music, style)));
    }
    // Only the features themselves are wanted.
    let features = DataConfig { count_periods: Vec::new(), ..data.clone() };
    let wanted = songs.keys().map(|music| (music.clone(), 1)).collect();
    let rows = song_rows(&features, wanted, &Arc::default(), output)?;
    let mut examples = Vec::new();
    for (music, style) in &songs {
        let Some(rows) = rows.get(music) else { continue };
        let rows = rows.phase(0);
        examples.push((song_statistics(rows.view()), *style));
        if excerpts {
            let excerpts = rows.axis_chunks_iter(Axis(0), EXCERPT);
            let whole = excerpts.filter(|excerpt| excerpt.nrows() == EXCERPT);
            examples.extend(whole.map(|excerpt| (song_statistics(excerpt), *style)));
        }
    }
    Ok((examples, songs.len()))
}

/// Fits a multinomial logistic regression, in which every style weighs the same: descent with
/// Nesterov's momentum, at the step that the largest curvature allows.
fn fit(styles: &[String], examples: &[Example]) -> StyleClassifier {
    let mut counts = vec![0_usize; styles.len()];
    examples.iter().for_each(|(_, style)| counts[*style] += 1);
    let present = counts.iter().filter(|&&count| count > 0).count();
    let share = |style: usize| 1.0 / (counts[style] * present) as f32;
    let shares: Array1<f32> = examples.iter().map(|(_, style)| share(*style)).collect();
    let width = examples.first().map_or(0, |(statistics, _)| statistics.len());
    let mut inputs =
        Array2::from_shape_fn((examples.len(), width), |(row, column)| examples[row].0[column]);
    let mean = shares.dot(&inputs);
    inputs -= &mean;
    let spread = shares.dot(&inputs.mapv(|value| value * value));
    let spread = spread.mapv(|square| square.sqrt().max(SMALLEST_SPREAD));
    inputs /= &spread;

    let targets = Array2::from_shape_fn((examples.len(), styles.len()), |(row, style)| {
        f32::from(u8::from(examples[row].1 == style))
    });
    // A column of ones is the bias.
    let ones = Array2::ones((examples.len(), 1));
    let inputs = ndarray::concatenate(Axis(1), &[inputs.view(), ones.view()])
        .unwrap_or_else(|_| unreachable!("both have a row an example"));
    let squares = inputs.mapv(|value| value * value).sum_axis(Axis(1));
    let step = 1.0 / (0.5 * shares.dot(&squares) + DECAY);
    let mut weights = Array2::<f32>::zeros((inputs.ncols(), styles.len()));
    let mut ahead = weights.clone();
    for number in 0..STEPS {
        let errors = softmax(inputs.dot(&ahead)) - &targets;
        let errors = errors * shares.view().insert_axis(Axis(1));
        let mut gradient = inputs.t().dot(&errors);
        gradient.scaled_add(DECAY, &ahead);
        let next = &ahead - &(gradient * step);
        let momentum = number as f32 / (number as f32 + 3.0);
        ahead = &next + &((&next - &weights) * momentum);
        weights = next;
    }
    let column = |style: usize| weights.column(style).iter().take(width).copied().collect();
    let mut classifier = StyleClassifier {
        styles: styles.to_vec(),
        mean: mean.to_vec(),
        spread: spread.to_vec(),
        weights: (0..styles.len()).map(column).collect(),
        bias: weights.row(width).to_vec(),
        least: LEAST,
        farthest: f32::MAX,
    };
    let distances = inputs.slice_axis(Axis(1), Slice::from(..width));
    let distances = distances.rows().into_iter().map(|row| root_mean_square(&row.to_vec()));
    classifier.farthest = ROOM * distances.fold(0.0, f32::max);
    classifier
}

/// Turns each row into shares.
fn softmax(mut logits: Array2<f32>) -> Array2<f32> {
    for mut row in logits.rows_mut() {
        let highest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        row.mapv_inplace(|logit| (logit - highest).exp());
        let total = row.sum();
        row /= total;
    }
    logits
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Statistics around a style's own, with a little noise.
    fn example(style: usize, number: usize) -> Example {
        let value = |column: usize| {
            let noise = ((number * 37 + column * 11) % 17) as f32 / 17.0 - 0.5;
            0.5 * noise + if column % 3 == style { 1.0 } else { 0.0 }
        };
        ((0..12).map(value).collect(), style)
    }

    #[test]
    fn styles_are_learned_whatever_their_number_of_songs() {
        let styles = ["a", "b", "c"].map(str::to_owned);
        let counts = [60, 6, 20];
        let examples = counts.iter().enumerate();
        let examples: Vec<Example> = examples
            .flat_map(|(style, &count)| (0..count).map(move |number| example(style, number)))
            .collect();
        let classifier = fit(&styles, &examples);
        for style in 0..3 {
            for number in 100..110 {
                let (statistics, _) = example(style, number);
                assert_eq!(classifier.of_statistics(&statistics), Some(style));
            }
        }
        let between: Vec<f32> = example(0, 1).0.iter().map(|_| 1.0 / 3.0).collect();
        assert_eq!(classifier.of_statistics(&between), None);
        assert_eq!(classifier.of_statistics(&[40.0; 12]), None, "like no song");
        assert_eq!(classifier, fit(&styles, &examples));
    }

    #[test]
    fn the_report_is_a_table() {
        let report = StyleReport {
            styles: vec!["lock".into(), "pop".into()],
            training_songs: 9,
            confusion: vec![vec![3, 0, 1], vec![0, 4, 0]],
            accuracy: Some(0.875),
        };
        assert_eq!(
            report.to_string(),
            "| songs of | lock | pop | mixed |\n|---|---|---|---|\n| lock | 3 | 0 | 1 |\n\
             | pop | 0 | 4 | 0 |\n\n9 training songs; of 8 test songs 87.5 % are found.\n"
        );
    }
}
