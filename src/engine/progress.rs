//! How far a generation has come, and what there is of it already.

use std::time::{Duration, Instant};

use ndarray::Array2;

use crate::{
    formats::{MusicInfo, Timings},
    motion::{Finisher, PositionsSource, Skeleton},
};

/// A stage of a generation, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Decoding and resampling the audio.
    Decoding,
    /// Computing music features.
    Features,
    /// Waiting for the model, then generating codes.
    Generating,
    /// Pose codes to motion, rotations, floor.
    Motion,
}

/// Hears how far a generation has come; called from several threads.
pub trait Progress: Send + Sync {
    /// A stage begins.
    fn stage(&self, _stage: Stage) {}
    /// The audio is decoded; so much of it is danced to.
    fn decoded(&self, _seconds: f64) {}
    /// `done` of `total` code pairs exist.
    fn codes(&self, _done: usize, _total: usize) {}
}

/// Hears nothing.
impl Progress for () {}

/// Hears a dance while it is generated.
pub trait Listener: Progress {
    /// The music is known, and what the dance will be; called once, before any frames.
    fn opened(&self, opening: Opening);
    /// The next frames of decoded motion, `[frames, 3 joints]`, for the opening's finisher. Called on the
    /// thread that makes everybody's frames: it must not wait.
    fn frames(&self, motion: Array2<f32>);
}

/// What is known of a dance before its first frame.
#[derive(Debug)]
pub struct Opening {
    /// Name of the model.
    pub model: String,
    /// The seed that is used.
    pub seed: u64,
    /// Rest skeleton.
    pub skeleton: Skeleton,
    /// Frames per second.
    pub fps: u32,
    /// Frames of the whole dance.
    pub frames: usize,
    /// Where positions come from.
    pub positions_source: PositionsSource,
    /// Tempo and beats, when asked for.
    pub music: Option<MusicInfo>,
    /// Wall time of what is done.
    pub timings: Timings,
    /// What was trimmed, truncated or assumed.
    pub warnings: Vec<String>,
    /// Makes a dance of the decoded motion.
    pub finisher: Finisher,
}

/// Measures a stage, in a span of its name.
pub(super) fn spent<T>(elapsed: &mut Duration, stage: &'static str, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = tracing::info_span!("stage", otel.name = stage).in_scope(work);
    *elapsed = started.elapsed();
    result
}
