//! From the decoder's output to a finished motion: root, floor, rotations, frame rate.

use ndarray::{ArrayView2, Axis};

use super::{Animation, Finisher, MotionError, Positions, Skeleton};

/// Frames between two questions whether to go on.
const PIECE: usize = 1024;

/// What a motion is finished to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinishOptions {
    /// Frames per second wanted: one of [`super::FRAME_RATES`].
    pub fps: u32,
    /// Whether the dancer travels; `false` holds x and z of the root at 0 and keeps y.
    pub root_motion: bool,
    /// Frames per second of the decoder's output.
    pub decoded_fps: u32,
    /// Where the root starts: x and z in metres.
    pub start: [f32; 2],
}

impl Default for FinishOptions {
    fn default() -> Self {
        Self {
            fps: 60,
            root_motion: true,
            decoded_fps: 60,
            start: [0.0; 2],
        }
    }
}

/// Where a dance's positions come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionsSource {
    /// The decoder's own positions, at its own frame rate.
    Decoder,
    /// Forward kinematics of resampled rotations.
    ForwardKinematics,
}

/// A motion that stands on the floor y = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// Rotations and root on the rest skeleton, at the wanted frame rate.
    pub animation: Animation,
    /// Joint positions `[frames, joints, 3]`, metres. The decoder's own have bones that stretch; the
    /// animation's feet follow theirs, and its root is within centimetres of theirs.
    pub positions: Positions,
    /// Where the positions come from.
    pub source: PositionsSource,
}

/// Finishes a decoder's output `[frames, 3 * joints]` (root velocity in columns 0..3, other joints
/// relative to the root, metres): the root starts at the skeleton's `root_height`, slow vertical
/// drift is removed, rotations are found, legs are bent to the decoder's feet, and the frame rate is
/// changed where another is wanted.
///
/// # Errors
/// [`MotionError::FrameRate`] for a rate that is not offered, [`MotionError::Shape`] if the columns
/// are not the skeleton's, [`MotionError::NotFinite`] for a NaN or an infinity.
pub fn finish(
    decoded: ArrayView2<'_, f32>,
    skeleton: &Skeleton,
    options: &FinishOptions,
) -> Result<Finished, MotionError> {
    let mut finisher = Finisher::whole(skeleton, options)?;
    finisher.push(decoded)?;
    finisher.end()
}

/// [`finish`] that asks now and then whether to go on; none if not.
///
/// # Errors
/// As [`finish`].
pub fn finish_while(
    decoded: ArrayView2<'_, f32>,
    skeleton: &Skeleton,
    options: &FinishOptions,
    goes_on: impl Fn() -> bool,
) -> Result<Option<Finished>, MotionError> {
    let mut finisher = Finisher::whole(skeleton, options)?;
    for piece in decoded.axis_chunks_iter(Axis(0), PIECE) {
        if !goes_on() {
            return Ok(None);
        }
        finisher.push(piece)?;
    }
    finisher.end().map(Some)
}
