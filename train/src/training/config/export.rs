//! Settings of the exported model.

use std::path::PathBuf;

use bailando::model::{MAX_CANDIDATES, MAX_GUIDANCE, MAX_TEMPERATURE, WeightStorage};
use serde::{Deserialize, Serialize};

use super::checks::at_least_one;

/// Stage `export`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExportConfig {
    pub folder: PathBuf,
    pub name: String,
    pub licence: String,
    pub root_height: f32,
    pub temperature: f32,
    pub guidance: f32,
    pub candidates: usize,
    pub redo: bool,
    pub hop: usize,
    pub lowest_pelvis: f32,
    pub weights: WeightStorage,
}

impl ExportConfig {
    /// What a manifest would be refused for after all the training.
    pub(super) fn check(&self) -> Result<(), String> {
        let numbers = [
            ("temperature", self.temperature, MAX_TEMPERATURE),
            ("guidance", self.guidance, MAX_GUIDANCE),
        ];
        for (name, value, most) in numbers {
            if !(0.0..=most).contains(&value) {
                return Err(format!("{name} ({value}) must lie in 0..={most}"));
            }
        }
        let height = self.root_height;
        if !(height > 0.0 && height.is_finite()) {
            return Err(format!("root_height ({height}) must be above 0"));
        }
        let lowest = self.lowest_pelvis;
        if !(lowest >= 0.0 && lowest.is_finite()) {
            return Err(format!("lowest_pelvis ({lowest}) must be 0 or more"));
        }
        if !(1..=MAX_CANDIDATES).contains(&self.candidates) {
            let candidates = self.candidates;
            return Err(format!("candidates ({candidates}) must lie in 1..={MAX_CANDIDATES}"));
        }
        at_least_one([("hop", self.hop)])
    }
}
