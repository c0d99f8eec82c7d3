//! What a stage brings to the loop that all stages share.

use burn_tensor::Tensor;

use super::{
    checkpoint::Checkpoint,
    config::{RunConfig, TrainingConfig},
    identity::Identity,
};
use crate::nn::{Parameters, Store, Trainable};

/// A stage's steps and tests, and the state that it keeps beside weights.
pub(super) trait TrainableStage<A: Trainable> {
    /// Names of the metrics; the first is the loss.
    const COLUMNS: &'static [&'static str];
    /// Names of the metrics on the test split; the first is the loss that decides which checkpoint
    /// is the best. Empty: none.
    const TEST_COLUMNS: &'static [&'static str] = &[];

    /// Computes the loss of a step, and the metrics, one number each.
    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A>;

    /// Returns the learning rate of the weights of this name, in units of the stage's rate. With 0
    /// they stay as they are, though the loss may have a derivative for them.
    fn rate_factor(&self, name: &str) -> f64 {
        let _ = name;
        1.0
    }

    /// Computes the metrics on the test split, without derivatives, dropout or change of any
    /// state; `None` where there is no test split.
    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let _ = parameters;
        None
    }

    /// Adds the state beside weights to a checkpoint.
    fn save(&self, checkpoint: &mut Checkpoint) {
        let _ = checkpoint;
    }

    /// Takes that state from a checkpoint.
    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), String> {
        let _ = checkpoint;
        Ok(())
    }
}

/// The loss that a step reduces, and its metrics.
pub(super) struct Losses<A: Trainable> {
    pub(super) loss: Tensor<A, 1>,
    pub(super) metrics: Vec<Tensor<A::InnerBackend, 1>>,
}

/// Name, settings and first weights of a stage.
pub(super) struct StageSpec<'a> {
    pub(super) name: &'static str,
    pub(super) run: &'a RunConfig,
    pub(super) training: &'a TrainingConfig,
    /// Everything that the result depends on.
    pub(super) identity: Identity,
    pub(super) store: Store,
    /// Windows that an epoch learns from.
    pub(super) windows: usize,
}
