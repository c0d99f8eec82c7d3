//! Length and optimiser of a stage, and how its learning rate falls.

use serde::{Deserialize, Serialize};

use super::checks::not_negative;

/// Length and optimiser of a stage.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the commented preset is the documentation")]
pub struct TrainingConfig {
    pub batch: usize,
    pub epochs: u64,
    pub steps: u64,
    pub rate: f64,
    pub betas: [f64; 2],
    pub schedule: Schedule,
    pub milestones: Vec<f64>,
    pub factor: f64,
    pub warmup_steps: u64,
    pub clip: f64,
}

/// How the learning rate falls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// By `factor` at each of `milestones`.
    Milestones,
    /// Along half a cosine down to `factor`.
    Cosine,
}

impl TrainingConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        if self.batch == 0 || (self.steps == 0 && self.epochs == 0) {
            return Err("batch and one of steps and epochs must be at least 1".into());
        }
        if !(self.rate > 0.0 && self.rate.is_finite()) {
            return Err(format!("rate ({}) must be above 0", self.rate));
        }
        if self.betas.iter().any(|beta| !(0.0..1.0).contains(beta)) {
            return Err(format!("betas ({:?}) must lie in 0..1", self.betas));
        }
        let shares = 0.0..=1.0;
        if self.milestones.iter().any(|share| !shares.contains(share)) {
            return Err(format!(
                "milestones ({:?}) must lie in 0..=1: they are shares of the run",
                self.milestones
            ));
        }
        not_negative([("factor", self.factor), ("clip", self.clip)])
    }

    /// Steps of the whole stage over `windows` different windows.
    pub(in crate::training) fn total_steps(&self, windows: usize) -> u64 {
        if self.steps > 0 {
            return self.steps;
        }
        (self.epochs * windows as u64).div_ceil(self.batch as u64)
    }

    /// The learning rate of a step out of `total`.
    pub(in crate::training) fn rate_at(&self, step: u64, total: u64) -> f64 {
        let share = step as f64 / total.max(1) as f64;
        let fall = match self.schedule {
            Schedule::Milestones => {
                let passed = self.milestones.iter().filter(|&&milestone| share >= milestone);
                self.factor.powi(passed.count() as i32)
            }
            Schedule::Cosine => {
                let wave = 0.5 * (1.0 + (std::f64::consts::PI * share).cos());
                self.factor + (1.0 - self.factor) * wave
            }
        };
        let warm = (step + 1) as f64 / (self.warmup_steps + 1) as f64;
        self.rate * fall * warm.min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::config::Config;

    #[test]
    fn rates_fall_as_scheduled() {
        let mut training = Config::parse("").unwrap().vqvae.training;
        training.rate = 1.0;
        let rates = [0, 19, 20, 40].map(|step| training.rate_at(step, 100));
        for (rate, wanted) in rates.into_iter().zip([1.0, 1.0, 0.1, 0.01]) {
            assert!((rate - wanted).abs() < 1e-12);
        }
        training.schedule = Schedule::Cosine;
        assert!((training.rate_at(50, 100) - 0.55).abs() < 1e-12);
        training.warmup_steps = 9;
        assert!((training.rate_at(0, 100) - 0.1).abs() < 1e-3);
    }
}
