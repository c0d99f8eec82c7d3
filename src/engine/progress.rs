//! How far a generation has come.

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
    /// `done` of `total` code pairs exist.
    fn codes(&self, _done: usize, _total: usize) {}
}

/// Hears nothing.
impl Progress for () {}
