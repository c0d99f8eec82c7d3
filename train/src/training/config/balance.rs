//! Which windows of the training data are drawn how often.

use serde::{Deserialize, Serialize};

use super::checks::within_range;

/// How often windows are drawn. At the published values every window is drawn once in a round.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BalanceConfig {
    pub styles: f64,
    pub phrases: f64,
    pub still: f64,
    pub damaged: f64,
}

impl BalanceConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        let shares = [
            ("styles", self.styles),
            ("phrases", self.phrases),
            ("still", self.still),
            ("damaged", self.damaged),
        ];
        within_range(shares, 0.0..=1.0, "0..=1")
    }
}
