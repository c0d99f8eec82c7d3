//! Fewer keys for a track of rotations, within a tolerance at every frame.
//!
//! A swing filter: from a key, a straight line is kept that passes every frame so far within the
//! tolerance; where no line passes one more frame, it ends in a key. Lines are constant
//! turns, which is what programs interpolate between keys (slerp).

use glam::{DQuat, DVec3};

/// Most frames between two keys; bounds the work per frame.
const LONGEST: usize = 32;
/// Most corrections of a line for one more frame.
const CORRECTIONS: usize = 12;

/// Values at some of the frames of a track, the first and the last among them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Keys<T> {
    pub(crate) frames: Vec<usize>,
    pub(crate) values: Vec<T>,
}

/// A line from a key: what is added per frame.
struct Line {
    slope: DVec3,
    frames: usize,
}

/// Returns the longest line from 0 that passes each of `offsets`, one frame apart, within
/// `tolerance`; one of a single frame at least.
fn longest_line(offsets: &[DVec3], tolerance: f64) -> Line {
    let mut slope = offsets.first().copied().unwrap_or_default();
    for count in 2..=offsets.len() {
        match corrected(slope, &offsets[..count], tolerance) {
            Some(better) => slope = better,
            None => return Line { slope, frames: count - 1 },
        }
    }
    Line { slope, frames: offsets.len() }
}

/// Returns a slope near `slope` whose line passes all `offsets` within `tolerance`: each frame
/// allows a ball of slopes, and the slope is moved to the farthest until it is in all of them.
fn corrected(mut slope: DVec3, offsets: &[DVec3], tolerance: f64) -> Option<DVec3> {
    for _ in 0..CORRECTIONS {
        let mut worst = (0.0, DVec3::ZERO);
        for (index, &offset) in offsets.iter().enumerate() {
            let time = (index + 1) as f64;
            let away = offset - slope * time;
            let distance = away.length();
            let over = (distance - tolerance) / time;
            if over > worst.0 {
                worst = (over, away / distance * over);
            }
        }
        if worst.0 <= tolerance * 1e-6 {
            return Some(slope);
        }
        slope += worst.1;
    }
    None
}

/// Reduces a track of rotations, which keep their sign along time, to keys between which constant
/// turns pass within `tolerance` radians.
pub(crate) fn reduce_rotations(track: &[DQuat], tolerance: f64) -> Keys<DQuat> {
    let between = |from: DQuat, to: DQuat| {
        let turn = from.inverse() * to;
        (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis()
    };
    let mut keys = Keys { frames: Vec::new(), values: Vec::new() };
    let Some(&first) = track.first() else { return keys };
    let (mut frame, mut value) = (0, first);
    let mut offsets = Vec::with_capacity(LONGEST);
    loop {
        keys.frames.push(frame);
        keys.values.push(value);
        if frame + 1 >= track.len() {
            return keys;
        }
        offsets.clear();
        let ahead = track[frame + 1..].iter().take(LONGEST);
        offsets.extend(ahead.map(|&next| between(value, next)));
        let line = longest_line(&offsets, tolerance);
        let turn = DQuat::from_scaled_axis(line.slope * line.frames as f64);
        value = (value * turn).normalize();
        frame += line.frames;
    }
}

impl<T: Copy> Keys<T> {
    /// Returns a key at every frame.
    pub(crate) fn every(track: &[T]) -> Self {
        Self { frames: (0..track.len()).collect(), values: track.to_vec() }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn at(keys: &Keys<DQuat>, frame: usize) -> DQuat {
        let next = keys.frames.partition_point(|&key| key < frame).max(1);
        let (from, to) = (keys.frames[next - 1], keys.frames[next]);
        let part = (frame - from) as f64 / (to - from) as f64;
        keys.values[next - 1].slerp(keys.values[next], part)
    }

    proptest! {
        #[test]
        fn every_frame_is_within_the_tolerance(
            steps in prop::collection::vec(prop::array::uniform3(-0.05..0.05_f64), 2..200),
            tolerance in 0.001..0.02_f64,
        ) {
            let mut turned = DQuat::IDENTITY;
            let track: Vec<DQuat> = steps.iter().map(|&step| {
                turned = (turned * DQuat::from_scaled_axis(step.into())).normalize();
                turned
            }).collect();
            let keys = reduce_rotations(&track, tolerance);
            prop_assert_eq!(keys.frames.last(), Some(&(track.len() - 1)));
            for (frame, &wanted) in track.iter().enumerate() {
                let angle = at(&keys, frame).angle_between(wanted);
                // Turns are added as vectors, which differ a little from turns one after another.
                prop_assert!(angle < 1.3 * tolerance, "frame {frame}: {angle}");
            }
        }
    }

    #[test]
    fn steady_movement_needs_few_keys() {
        let track: Vec<DQuat> =
            (0..300).map(|frame| DQuat::from_rotation_y(0.01 * f64::from(frame))).collect();
        let keys = reduce_rotations(&track, 1e-4);
        assert_eq!(keys.frames.len(), 1 + 299_usize.div_ceil(LONGEST));
        assert_eq!(Keys::every(&track).frames.len(), 300);
        assert!(reduce_rotations(&[], 0.1).frames.is_empty());
        assert_eq!(reduce_rotations(&track[..1], 0.1).frames, [0]);
    }
}
