//! What a pair of pose codes looks like (paper, Fig. 7).

use ndarray::{Axis, Slice};

use super::{EngineError, code_model::SharedDecoder};
use crate::{
    model::Manifest,
    motion::{self, FinishOptions, Positions, PositionsSource},
};

/// How often a pair is repeated, and how many of these are shown: those in the middle, far from
/// the zero padding at the ends.
const REPEATS: (usize, usize) = (12, 4);

/// Joints `[frames, joints, 3]`, metres, of a pair that is repeated and held in place.
pub(crate) fn pose(
    codes: [u32; 2],
    decoder: &SharedDecoder,
    manifest: &Manifest,
) -> Result<Positions, EngineError> {
    let (repeats, shown) = REPEATS;
    let decoded = decoder.lock().decode(&vec![codes; repeats])?;
    let motion = manifest.motion_frame.into_world(decoded)?;
    let first = (repeats - shown) / 2 * manifest.frames_per_code;
    let middle = Slice::from(first..first + shown * manifest.frames_per_code);
    let options = FinishOptions {
        fps: manifest.fps,
        root_motion: false,
        decoded_fps: manifest.fps,
        clean: false,
        positions: PositionsSource::Decoder,
        ..FinishOptions::default()
    };
    let middle = motion.slice_axis(Axis(0), middle);
    Ok(motion::finish(middle, &manifest.skeleton, &options)?.positions)
}
