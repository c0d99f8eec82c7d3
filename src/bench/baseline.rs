//! Times of other programs for the same work on the same machine, as
//! `benches/baseline/baseline.py` writes them.

use std::collections::BTreeMap;

use serde::Deserialize;

/// Times of librosa and PyTorch.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct Baseline {
    /// Seconds of a stage with one thread, by its name here.
    #[serde(default)]
    stages: BTreeMap<String, f64>,
    /// Seconds of a code with fused attention and a sliding window, by number of threads.
    #[serde(default)]
    code_s: BTreeMap<usize, f64>,
}

impl Baseline {
    pub(super) fn stage(&self, name: &str) -> Option<f64> {
        self.stages.get(name).copied()
    }

    pub(super) fn code_s(&self, threads: usize) -> Option<f64> {
        self.code_s.get(&threads).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_baseline_is_read() {
        let text = r#"{"stages": {"features_3840": 0.5}, "code_s": {"1": 0.146, "2": 0.081},
            "versions": {}}"#;
        let baseline: Baseline = serde_json::from_str(text).unwrap();
        assert_eq!(baseline.stage("features_3840"), Some(0.5));
        assert_eq!(baseline.stage("beats"), None);
        assert_eq!(baseline.code_s(2), Some(0.081));
    }
}
