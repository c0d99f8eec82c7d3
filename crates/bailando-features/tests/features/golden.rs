//! Reading the golden sets: an `index.json` and a folder of `.npy` files per clip.

use std::{collections::BTreeMap, path::Path};

pub(crate) use bailando_testkit::arrays::load;
use ndarray::{ArrayD, Ix1, IxDyn};
use ndarray_npy::read_npy;
use serde_json::{Value, json};

use crate::comparison::Tolerance;

/// An `index.json`.
pub(crate) struct GoldenSet {
    index: Value,
}

impl GoldenSet {
    pub(crate) fn read(root: &Path) -> Self {
        Self { index: bailando_testkit::read_json(&root.join("index.json")) }
    }

    /// Clips by name.
    pub(crate) fn clips(&self) -> Vec<(&String, &Value)> {
        self.index["clips"].as_object().unwrap().iter().collect()
    }

    /// Songs of which only the onset envelope and the beats are given, by name.
    pub(crate) fn beats_only(&self) -> BTreeMap<String, Value> {
        serde_json::from_value(self.index["beats_only"].clone()).unwrap()
    }
}

/// A vector of float32.
pub(crate) fn load_vector(path: &Path) -> Vec<f32> {
    load::<f32, Ix1>(path).to_vec()
}

/// A vector or a scalar, of float32 or float64: the sets differ in how they store single numbers.
pub(crate) fn load_as_f32(path: &Path) -> Vec<f32> {
    match read_npy::<_, ArrayD<f32>>(path) {
        Ok(values) => values.iter().copied().collect(),
        Err(_) => {
            let values = load::<f64, IxDyn>(path);
            values.iter().map(|&value| value as f32).collect()
        }
    }
}

/// The tolerances of FEATURES section 10, for sets whose index does not repeat them.
pub(crate) fn tolerance_of(stage: &str) -> Tolerance {
    let (absolute, relative) = match stage {
        "mel_db" | "mfcc" | "onset_env" => (5e-3, 0.0),
        "mfcc_delta" => (3e-3, 0.0),
        "harmonic" | "percussive" => (5e-6, 0.0),
        "cqt_mag" => (2e-4, 1e-4),
        "chroma_cqt" => (5e-4, 0.0),
        "tempogram" => (2e-4, 0.0),
        "tempo" => (0.0, 1e-5),
        // The tuning itself is compared exactly with the index; the file is read as f32.
        "tuning" => (1e-6, 0.0),
        "beats" => (0.0, 0.0),
        // Compared by column groups.
        "features" => (0.0, 0.0),
        unknown => panic!("no tolerance for {unknown}"),
    };
    Tolerance { absolute, relative }
}

/// The column groups of a feature matrix in the form that an index has them.
pub(crate) fn column_tolerances() -> Value {
    let group = |stage: &str, start: usize, end: usize| {
        let tolerance = tolerance_of(stage);
        json!({"range": [start, end], "atol": tolerance.absolute, "rtol": tolerance.relative})
    };
    json!({
        "mfcc": group("mfcc", 0, 20),
        "mfcc_delta": group("mfcc_delta", 20, 40),
        "chroma_cqt": group("chroma_cqt", 40, 52),
        "onset_env": group("onset_env", 52, 53),
        "beats": group("beats", 53, 54),
        "tempogram": group("tempogram", 54, 438),
    })
}
