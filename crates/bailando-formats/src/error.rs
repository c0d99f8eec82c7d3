//! Why a motion could not be written.

/// The reason why a motion could not be written, or an option about it not be read.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// An option has another value than those it accepts.
    #[error("{name} {got:?} is not available: choose {accepted}")]
    Choice {
        /// Name of the option as in the API.
        name: &'static str,
        /// Value that was asked for.
        got: String,
        /// Values that there are.
        accepted: &'static str,
    },
    /// A text does not describe a continuation.
    #[error("this is not the `tail` of a dance")]
    Continuation,
    /// The motion contradicts itself, so that no file could be right.
    #[error("the dance can't be written: {0}")]
    Inconsistent(String),
    /// The model's skeleton is not one that the target or the format knows.
    #[error("the model's joint `{joint}` is not one of SMPL's 24, which `{target}` needs")]
    Skeleton {
        /// First joint that is unknown.
        joint: String,
        /// Target skeleton or format that was asked for.
        target: &'static str,
    },
    /// The model's skeleton lacks a joint that the format must have.
    #[error("the model's skeleton has no `{bone}`, without which there is no {format}")]
    NoBone {
        /// Bone or joint that is missing.
        bone: String,
        /// Name of the format.
        format: &'static str,
    },
    /// The music has fewer bars than are wanted.
    #[error(
        "{bars} bars are wanted, and the part of the song that is danced to has {found} whole \
         ones: choose fewer `bars`, or a longer part"
    )]
    Bars {
        /// Bars that are wanted.
        bars: usize,
        /// Whole bars that there are.
        found: usize,
    },
    /// A motion could not be changed.
    #[error("the dance could not be changed: {0}")]
    Motion(#[source] bailando_motion::MotionError),
    /// A caller's rig cannot be used.
    #[error(
        "the rig can't be danced with: {0}. A rig is a .bvh, .glb or .vrm file of one humanoid in \
         its rest pose"
    )]
    Rig(String),
    /// A caller's rig has more bytes than are allowed.
    #[error("the rig is larger than the {limit} bytes that a .bvh, .glb or .vrm file may have")]
    RigTooLarge {
        /// Most bytes.
        limit: usize,
    },
    /// The bones of a caller's rig are no humanoid that could dance.
    #[error("the rig can't be danced with: {0}; `rig_mapping` can say which bones are meant")]
    Figure(#[source] bailando_motion::MotionError),
    /// A NumPy archive could not be written.
    #[error("the result could not be written as npz: {0}")]
    Npz(#[from] zip::result::ZipError),
    /// The frame rate could not be changed to the format's own.
    #[error("the frame rate could not be changed: {0}")]
    Rate(#[from] bailando_motion::MotionError),
    /// The motion is too long for the format's sizes.
    #[error("the dance is too long for {format}: it would take {bytes} bytes")]
    TooLong {
        /// Name of the format.
        format: &'static str,
        /// Bytes that it would take.
        bytes: u64,
    },
    /// A stored motion is not what was written.
    #[error("the stored dance cannot be read: {0}")]
    Stored(String),
    /// JSON could not be written.
    #[error("the result could not be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// BVH could not be written.
    #[error("the result could not be written as BVH: {0}")]
    Bvh(#[from] std::fmt::Error),
}
