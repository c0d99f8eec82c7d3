//! Scores of candidates, by the frames that their newest codes decide about.

use std::ops::Range;

use ndarray::{ArrayView1, ArrayView2, Axis};

use super::{EngineError, code_model::MotionDecoder, segment::Score};
use crate::{
    model::Manifest,
    motion::{dance_beats, joint_speed, mutual_beat_alignment, slow_share},
};

/// Codes at a segment's end that are scored with the next one: their speed is smoothed, and
/// decoded, with what follows.
const UNSETTLED: usize = 2;
/// Committed codes before those scored that are decoded with them. The decoder sees further, so
/// that the scored frames are near the final ones, not the same; all of it would double the cost.
const CONTEXT: usize = 3;
/// A pelvis that is no more metres above the lowest joint is one that only a partner holds up:
/// dancers of pairs do so in recordings.
const GROUND: f32 = 0.68;

/// Scores candidates.
pub(super) struct Scorer<'a> {
    /// Frames of the music's beats, ascending.
    pub(super) beats: &'a [usize],
    pub(super) decoder: &'a mut dyn MotionDecoder,
    pub(super) manifest: &'a Manifest,
}

impl Scorer<'_> {
    /// Scores candidates of one length by the frames that their codes from `committed` on decide
    /// about; `ends` says that no more follow.
    pub(super) fn score(
        &mut self,
        candidates: &[&[[u32; 2]]],
        committed: usize,
        ends: bool,
    ) -> Result<Vec<Score>, EngineError> {
        let length = candidates.first().map_or(0, |codes| codes.len());
        let from = committed.saturating_sub(UNSETTLED);
        let to = length - if ends { 0 } else { UNSETTLED };
        let first = from.saturating_sub(CONTEXT);
        let seen: Vec<_> = candidates.iter().map(|codes| &codes[first..]).collect();
        let decoded = self.decoder.decode_batch(&seen)?;
        decoded.axis_iter(Axis(0)).map(|motion| self.of_motion(motion, first, from..to)).collect()
    }

    /// Scores the frames of some codes, given the motion from that of code `first` on.
    fn of_motion(
        &self,
        motion: ArrayView2<'_, f32>,
        first: usize,
        codes: Range<usize>,
    ) -> Result<Score, EngineError> {
        let per_code = self.manifest.frames_per_code;
        let motion = self.manifest.motion_frame.into_world(motion.to_owned())?;
        let speed = joint_speed(motion.view());
        let beats = dance_beats(&speed).into_iter();
        let beats: Vec<usize> = beats.map(|frame| first * per_code + frame).collect();
        let scored = codes.start * per_code..codes.end * per_code;
        let (start, end) = (scored.start - first * per_code, scored.end - first * per_code);
        // There is one speed fewer than frames.
        let speed = &speed[start..end.min(speed.len())];
        let mut frames = motion.rows().into_iter().skip(start).take(end - start);
        Ok(Score {
            slow: slow_share(speed, f64::from(self.manifest.fps)),
            low: frames.any(|frame| pelvis_height(frame) < GROUND),
            meeting: mutual_beat_alignment(self.beats, &beats, scored).unwrap_or(0.0),
        })
    }
}

/// Metres of the root above the lowest joint, in a frame of root-relative joints.
fn pelvis_height(frame: ArrayView1<'_, f32>) -> f32 {
    // The root's own columns hold its velocity.
    let heights = frame.iter().skip(4).step_by(3);
    -heights.copied().fold(0.0, f32::min)
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn a_pelvis_is_above_the_lowest_joint() {
        let frame = array![9.0, -9.0, 9.0, 0.1, -0.5, 0.2, 0.0, -0.8, -1.0, 0.3, 0.6, -2.0];
        assert_eq!(pelvis_height(frame.view()), 0.8);
    }
}
