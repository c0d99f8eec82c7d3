//! The motion of a pair of pose codes, as JSON.

use bailando_motion::Positions;
use serde::Serialize;

#[cfg(feature = "openapi")]
use crate::numbers::PoseNumbers;
use crate::{
    error::FormatError,
    numbers::{Block, Encoding, Numbers},
};

/// The motion of a pair of pose codes, repeated (paper, Fig. 7).
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = CodePose))]
pub struct CodePoseJson<'a> {
    /// Code of the upper half of the body.
    upper: u32,
    /// Code of the lower half.
    lower: u32,
    /// Frames per second.
    fps: u32,
    /// Number of frames.
    frames: usize,
    /// World positions in metres, `[frames][joints][x y z]`, in place.
    #[cfg_attr(feature = "openapi", schema(value_type = PoseNumbers))]
    positions: Numbers<'a>,
}

/// Writes `positions` `[frames, joints, 3]` of a pair of codes.
///
/// # Errors
/// None that is known; writing JSON is fallible by its type.
pub fn pose_json(
    [upper, lower]: [u32; 2],
    fps: u32,
    positions: &Positions,
) -> Result<Vec<u8>, FormatError> {
    Ok(serde_json::to_vec(&CodePoseJson {
        upper,
        lower,
        fps,
        frames: positions.dim().0,
        positions: Numbers { block: Block::Positions(positions.view()), encoding: Encoding::Json },
    })?)
}
