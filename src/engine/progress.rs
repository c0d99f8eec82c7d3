//! Progress of a generation, and its motion as a stream.

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

/// Receives a generation's progress; called from several threads.
///
/// The engine drops it when the work has ended, whichever way: until then it can own what the work
/// uses up, for example a permit.
pub trait Progress: Send + Sync {
    /// A stage begins.
    fn stage(&self, _stage: Stage) {}
    /// The audio is decoded: the part that is used lasts so many seconds.
    fn decoded(&self, _seconds: f64) {}
    /// `done` of `total` code pairs exist.
    fn codes(&self, _done: usize, _total: usize) {}
}

/// Ignores everything.
impl Progress for () {}

/// Receives a motion while it is generated.
pub trait MotionStream: Send + Sync {
    /// The music is known, and what the motion will be; called once, before any frames.
    fn opened(&self, opening: Opening);
    /// The next frames of decoded motion, `[frames, 3 joints]`, for the opening's finisher. The
    /// decoder's thread calls it, which serves all requests: it must not wait.
    fn frames(&self, motion: Array2<f32>);
}

/// Properties of a motion that are known before its first frame.
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
    /// Frames of the whole motion.
    pub frames: usize,
    /// Where positions come from.
    pub positions_source: PositionsSource,
    /// Style of the dance, or `mixed`; none from a model without styles.
    pub style: Option<String>,
    /// Tempo and beats, when asked for.
    pub music: Option<MusicInfo>,
    /// Wall time of the stages so far.
    pub timings: Timings,
    /// What was trimmed, truncated or assumed.
    pub warnings: Vec<String>,
    /// Finishes the decoded motion.
    pub finisher: Finisher,
}

/// Measures a stage, in a span of its name.
pub(super) fn spent<T>(elapsed: &mut Duration, stage: &'static str, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = tracing::info_span!("stage", otel.name = stage).in_scope(work);
    *elapsed = started.elapsed();
    result
}
