//! What a pair of pose codes looks like, as JSON.

use serde::Serialize;
use utoipa::ToSchema;

use super::{
    FormatError,
    numbers::{Block, Numbers, PoseNumbers},
};
use bailando_motion::Positions;

/// A pair of pose codes, danced again and again (paper, Fig. 7).
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = CodePose)]
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
    #[schema(value_type = PoseNumbers)]
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
        positions: Numbers::new(Block::Positions(positions.view()), super::Encoding::Json),
    })?)
}
