//! Comparing matrices within a tolerance, and remembering how close each stage came to it.

use std::collections::BTreeMap;

use ndarray::{Array2, Axis, Slice};
use serde_json::Value;

/// The condition `|got - expected| <= absolute + relative |expected|`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tolerance {
    pub(crate) absolute: f64,
    pub(crate) relative: f64,
}

impl Tolerance {
    pub(crate) fn absolute(absolute: f64) -> Self {
        Self { absolute, relative: 0.0 }
    }

    /// `atol` and `rtol` of an index; null, for the whole matrix, is exact and never used.
    pub(crate) fn of(about: &Value) -> Self {
        let number = |key: &str| about[key].as_f64().unwrap_or(0.0);
        Self { absolute: number("atol"), relative: number("rtol") }
    }

    /// Error over the tolerance; above 1 is a failure.
    fn share(self, got: f32, expected: f32) -> f64 {
        let (got, expected) = (f64::from(got), f64::from(expected));
        let error = (got - expected).abs();
        if error == 0.0 {
            return 0.0;
        }
        let share = error / (self.absolute + self.relative * expected.abs());
        // Not a number never passes.
        if share.is_nan() { f64::INFINITY } else { share }
    }
}

/// The worst error of every stage compared.
#[derive(Debug, Default)]
pub(crate) struct Checked {
    stages: BTreeMap<String, Worst>,
}

#[derive(Debug, Default)]
struct Worst {
    clips: usize,
    share: f64,
    error: f64,
    clip: String,
}

impl Checked {
    /// Compares `expected` with as many first rows of `got`.
    pub(crate) fn compare(
        &mut self,
        stage: &str,
        clip: &str,
        got: &Array2<f32>,
        expected: &Array2<f32>,
        tolerance: Tolerance,
    ) {
        assert_eq!(got.ncols(), expected.ncols(), "{clip}: columns of {stage}");
        assert!(
            got.nrows() >= expected.nrows() && expected.nrows() > 0,
            "{clip}: {} rows of {stage}, {} in the golden file",
            got.nrows(),
            expected.nrows()
        );
        let worst = self.stages.entry(stage.to_owned()).or_default();
        worst.clips += 1;
        for ((row, column), &expected) in expected.indexed_iter() {
            let got = got[[row, column]];
            let share = tolerance.share(got, expected);
            assert!(
                share <= 1.0,
                "{clip}: {stage} [{row}, {column}] is {got} instead of {expected}, {share:.2} of \
                 the tolerance"
            );
            if share > worst.share {
                worst.share = share;
                worst.error = f64::from(got - expected).abs();
                clip.clone_into(&mut worst.clip);
            }
        }
    }

    /// Compares a whole feature matrix by the column groups of an index.
    pub(crate) fn matrix(
        &mut self,
        clip: &str,
        got: &Array2<f32>,
        expected: &Array2<f32>,
        cqt: &Array2<f32>,
        groups: &Value,
    ) {
        assert_eq!(got.dim(), expected.dim(), "{clip}: shape of the matrix");
        let groups = groups.as_object().unwrap();
        let mut covered = 0;
        for (group, about) in groups {
            let edge = |i: usize| about["range"][i].as_u64().unwrap() as usize;
            let select = |matrix: &Array2<f32>| {
                let columns = matrix.slice_axis(Axis(1), Slice::from(edge(0)..edge(1)));
                if group == "chroma_cqt" {
                    columns.select(Axis(0), &frames_with_tone(cqt))
                } else {
                    columns.to_owned()
                }
            };
            covered += edge(1) - edge(0);
            let name = format!("features {group}");
            let tolerance = Tolerance::of(about);
            self.compare(&name, clip, &select(got), &select(expected), tolerance);
        }
        assert_eq!(covered, expected.ncols(), "{clip}: columns compared");
        self.stages.entry("features".to_owned()).or_default().clips += 1;
    }

    /// Asserts that every stage was compared in as many clips as the set has files of it.
    pub(crate) fn assert_clips(&self, expected: &[(&str, usize)]) {
        for &(stage, clips) in expected {
            let compared = self.stages.get(stage).map_or(0, |worst| worst.clips);
            assert_eq!(compared, clips, "clips in which {stage} was compared");
        }
    }

    /// Prints the worst error of every stage.
    pub(crate) fn report(&self, set: &str) {
        for (stage, worst) in &self.stages {
            println!(
                "{set}: {stage}: {} clips, worst {:.3} of the tolerance, error {:.2e} {}",
                worst.clips, worst.share, worst.error, worst.clip
            );
        }
    }
}

/// Rows whose strongest CQT magnitude is above 1e-4 of the clip's: elsewhere chroma is normalised
/// noise (FEATURES section 10). All rows of a silent clip, whose chroma is zero.
pub(crate) fn frames_with_tone(cqt: &Array2<f32>) -> Vec<usize> {
    let strongest = |values: &mut dyn Iterator<Item = &f32>| values.copied().fold(0.0, f32::max);
    let of_clip = strongest(&mut cqt.iter());
    (0..cqt.nrows())
        .filter(|&row| strongest(&mut cqt.row(row).iter()) > 1e-4 * of_clip || of_clip == 0.0)
        .collect()
}
