//! A dance's beats moved towards those of its music, as a sequencer quantises what was played.
//!
//! Dancers are a little early or late: a model that repeats them on the count is so as well.

use bailando::motion::{Positions, dance_beats, joint_speed};

use super::{FPS, Motion};

/// Fewest frames between two beats that both keep their place in the moved dance.
const CLOSEST: f64 = 6.0;

/// A frame of the moved dance, and how many frames later it is than in the recording.
#[derive(Clone, Copy, Debug)]
struct Knot {
    frame: f64,
    late: f64,
}

/// Moves each beat of a motion towards the nearest of `counts_s` (seconds from frame 0), by at most
/// `most` frames; in between it is a little slower or faster, without a jump in speed. As long
/// as before, and the same where there is nothing to move.
#[must_use]
pub fn quantised(motion: &Motion, counts_s: &[f64], most: usize) -> Motion {
    let Some(last) = motion.frames().checked_sub(1) else {
        return motion.clone();
    };
    let counts: Vec<f64> = counts_s
        .iter()
        .map(|&count| count * FPS as f64)
        .filter(|&count| (0.0..last as f64).contains(&count))
        .collect();
    let knots = knots(motion, &counts, most as f64, last as f64);
    let positions = motion.positions();
    Motion::new(Positions::from_shape_fn(positions.dim(), |(frame, joint, axis)| {
        let recorded = (frame as f64 - late_at(&knots, frame as f64)).clamp(0.0, last as f64);
        let (before, part) = (recorded.floor(), recorded.fract() as f32);
        let value = |frame: usize| positions[[frame.min(last), joint, axis]];
        let here = value(before as usize);
        here + part * (value(before as usize + 1) - here)
    }))
}

/// Both ends, which stay, and the beats where they go to.
fn knots(motion: &Motion, counts: &[f64], most: f64, last: f64) -> Vec<Knot> {
    let mut knots = vec![Knot { frame: 0.0, late: 0.0 }];
    for beat in dance_beats(&joint_speed(motion.decoded().view())) {
        let beat = beat as f64;
        let nearest =
            counts.iter().copied().min_by(|a, b| (a - beat).abs().total_cmp(&(b - beat).abs()));
        let late = nearest.map_or(0.0, |count| (count - beat).clamp(-most, most));
        let frame = beat + late;
        if knots.last().is_some_and(|knot| frame - knot.frame > CLOSEST) && last - frame > CLOSEST {
            knots.push(Knot { frame, late });
        }
    }
    knots.push(Knot { frame: last, late: 0.0 });
    knots
}

/// How late a frame is, between two knots along a curve that is level at both.
fn late_at(knots: &[Knot], frame: f64) -> f64 {
    let next = knots.partition_point(|knot| knot.frame <= frame);
    match (next.checked_sub(1).map(|at| knots[at]), knots.get(next)) {
        (Some(from), Some(to)) => {
            let part = (frame - from.frame) / (to.frame - from.frame);
            from.late + (to.late - from.late) * part * part * (3.0 - 2.0 * part)
        }
        (Some(end), None) | (None, Some(&end)) => end.late,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use bailando::motion::beat_align_score;

    use super::*;
    use crate::data::JOINTS;

    /// Everything moves along x, slowest every `period` frames, from frame `first` on.
    fn dance(frames: usize, period: f64, first: f64) -> Motion {
        let mut walked = 0.0;
        let mut places = Positions::zeros((frames, JOINTS, 3));
        for (frame, mut pose) in places.outer_iter_mut().enumerate() {
            pose.column_mut(0).fill(walked as f32);
            let phase = std::f64::consts::TAU * (frame as f64 + 0.5 - first) / period;
            walked += 0.02 * (1.5 - phase.cos());
        }
        Motion::new(places)
    }

    fn beats(motion: &Motion) -> Vec<usize> {
        dance_beats(&joint_speed(motion.decoded().view()))
    }

    fn counts(period: f64) -> Vec<f64> {
        (0..20).map(|beat| f64::from(beat) * period / 60.0).collect()
    }

    #[test]
    fn beats_that_are_late_come_on_the_count() {
        let late = dance(400, 40.0, 3.0);
        let on_time = quantised(&late, &counts(40.0), 4);
        let counts: Vec<usize> = (1..9).map(|count| 40 * count).collect();
        assert!(beat_align_score(&counts, &beats(&late)) < 0.7);
        assert!(beat_align_score(&counts, &beats(&on_time)) > 0.93);
        assert_eq!(on_time.frames(), late.frames());
    }

    #[test]
    fn nothing_moves_further_than_it_may() {
        let late = dance(400, 40.0, 9.0);
        let moved = quantised(&late, &counts(40.0), 3);
        // The first is too near to the start, which stays.
        for (moved, late) in beats(&moved).into_iter().zip(beats(&late)).skip(1) {
            assert!((2..=4).contains(&(late - moved)), "{late} {moved}");
        }
    }

    #[test]
    fn without_music_or_leave_it_stays_as_recorded() {
        let recorded = dance(200, 40.0, 7.0);
        assert_eq!(quantised(&recorded, &[], 4), recorded);
        assert_eq!(quantised(&recorded, &counts(40.0), 0), recorded);
        let still = Motion::new(Positions::zeros((30, JOINTS, 3)));
        assert_eq!(quantised(&still, &counts(40.0), 4), still);
        let nothing = Motion::new(Positions::zeros((0, JOINTS, 3)));
        assert_eq!(quantised(&nothing, &counts(40.0), 4), nothing);
    }
}
