//! Beats of a motion: where a body moves least (METRICS.md "Beat Align Score", paper Eq. 15).

use std::ops::Range;

use ndarray::ArrayView2;

/// A mean speed of the joints below this is slow, m/s (METRICS.md).
const SLOW: f64 = 0.15;
/// Deviation of the Gaussian that smooths the speed, in frames.
const SMOOTHING: f64 = 5.0;
/// Reach of the smoothing: four deviations.
const RADIUS: usize = 20;
/// Deviation of the Gaussian that rewards a near beat, in frames.
const TOLERANCE: f64 = 3.0;

/// Returns the mean speed of the joints from each frame to the next, metres per frame, of motion
/// `[frames, 3 joints]`: root velocity in columns 0..3, joints relative to the root, in world
/// directions. One value fewer than frames.
#[must_use]
pub fn joint_speed(motion: ArrayView2<'_, f32>) -> Vec<f64> {
    let joints = motion.ncols() / 3;
    let steps = motion.outer_iter().zip(motion.outer_iter().skip(1));
    let speeds = steps.map(|(now, next)| {
        let moved = |joint: usize| {
            let axes = (0..3).map(|axis| {
                let column = 3 * joint + axis;
                let relative = match joint {
                    0 => 0.0,
                    _ => next[column] - now[column],
                };
                f64::from(now[axis] + relative).powi(2)
            });
            axes.sum::<f64>().sqrt()
        };
        (0..joints).map(moved).sum::<f64>() / joints.max(1) as f64
    });
    speeds.collect()
}

/// Returns the share of the frames whose mean speed of the joints, metres per frame, is below
/// 0.15 m/s.
#[must_use]
pub fn slow_share(speed: &[f64], frames_per_second: f64) -> f64 {
    let is_slow = |step: &&f64| **step * frames_per_second < SLOW;
    speed.iter().filter(is_slow).count() as f64 / speed.len().max(1) as f64
}

/// Finds the dance beats: strict local minima of the smoothed speed, never its ends.
#[must_use]
pub fn dance_beats(speed: &[f64]) -> Vec<usize> {
    let smooth = smoothed(speed);
    let minimum = |at: &usize| smooth[at - 1] > smooth[*at] && smooth[*at] < smooth[at + 1];
    (1..smooth.len().saturating_sub(1)).filter(minimum).collect()
}

/// Smooths a speed with the Gaussian of [`dance_beats`]; the ends are mirrored (half-sample
/// symmetric).
#[must_use]
pub fn smoothed(curve: &[f64]) -> Vec<f64> {
    let weight = |at: usize| {
        let distance = at as f64 - RADIUS as f64;
        (-0.5 * (distance / SMOOTHING).powi(2)).exp()
    };
    let weights: Vec<f64> = (0..=2 * RADIUS).map(weight).collect();
    let total: f64 = weights.iter().sum();
    let at_centre = |centre: usize| {
        let taps = weights.iter().enumerate().map(|(at, weight)| {
            let place = (centre + at) as isize - RADIUS as isize;
            weight * curve[mirrored(place, curve.len())]
        });
        taps.sum::<f64>() / total
    };
    (0..curve.len()).map(at_centre).collect()
}

fn mirrored(place: isize, length: usize) -> usize {
    let folded = place.rem_euclid(2 * length as isize).unsigned_abs();
    folded.min(2 * length - 1 - folded)
}

/// Returns the Beat Align Score of `beats`: the mean of `exp(-d^2 / (2 * 3^2))`, `d` frames to the
/// nearest of `others` (ascending); 0 when either is empty.
#[must_use]
pub fn beat_align_score(beats: &[usize], others: &[usize]) -> f64 {
    if beats.is_empty() {
        return 0.0;
    }
    let one = |&beat: &usize| {
        let after = others.partition_point(|&other| other < beat);
        let neighbours = [after.checked_sub(1), Some(after)].into_iter().flatten();
        let distances = neighbours.filter_map(|at| Some(others.get(at)?.abs_diff(beat)));
        let nearest = distances.min();
        nearest.map_or(0.0, |d| (-0.5 * (d as f64 / TOLERANCE).powi(2)).exp())
    };
    beats.iter().map(one).sum::<f64>() / beats.len() as f64
}

/// Returns the mean score, 0 to 1, of the beats of both kinds within `frames` against the other
/// kind; `None` without any.
///
/// Both lists ascend. Both kinds count: by the music's alone, more dance beats would always be
/// better.
#[must_use]
pub fn mutual_beat_alignment(
    music: &[usize],
    dance: &[usize],
    frames: Range<usize>,
) -> Option<f64> {
    let within = |beats: &[usize]| -> Vec<usize> {
        let beats = beats.iter().copied();
        beats.filter(|beat| frames.contains(beat)).collect()
    };
    let (of_music, of_dance) = (within(music), within(dance));
    let count = of_music.len() + of_dance.len();
    let sum = of_music.len() as f64 * beat_align_score(&of_music, dance)
        + of_dance.len() as f64 * beat_align_score(&of_dance, music);
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use ndarray::array;

    use super::*;

    fn close(got: f64, expected: f64) {
        assert!((got - expected).abs() < 1e-12, "{got} {expected}");
    }

    #[test]
    fn speed_is_of_places_in_the_world() {
        // The root walks along x; the other joint stays where it is, then moves by (0, 4, 3) more.
        let motion = array![
            [1.0_f32, 0.0, 0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, -1.0, 1.0, 0.0],
            [9.0, 9.0, 9.0, -1.0, 5.0, 3.0],
        ];
        assert_eq!(joint_speed(motion.view()), [0.5, 2.5]);
        assert!(joint_speed(motion.slice_axis(ndarray::Axis(0), (..1).into())).is_empty());
    }

    #[test]
    fn smoothing_is_a_gaussian_with_mirrored_ends() {
        let mut impulse = vec![0.0; 101];
        impulse[50] = 1.0;
        let smooth = smoothed(&impulse);
        close(smooth.iter().sum(), 1.0);
        close(smooth[55] / smooth[50], (-0.5_f64).exp());
        assert!(smooth[70] > 0.0 && smooth[71] == 0.0);
        // Half-sample symmetric: the first value counts twice at the edge.
        let mut edge = vec![0.0; 101];
        edge[0] = 1.0;
        close(smoothed(&edge)[0], smooth[50] + smooth[51]);
        let constant = smoothed(&[2.0; 7]);
        assert!(constant.iter().all(|v| (v - 2.0).abs() < 1e-12));
    }

    #[test]
    fn dance_beats_are_where_the_speed_is_least() {
        let speed: Vec<f64> = (0..300).map(|t| 1.0 + (TAU * t as f64 / 60.0).cos()).collect();
        assert_eq!(dance_beats(&speed), [30, 90, 150, 210, 270]);
        assert!(dance_beats(&[1.0; 50]).is_empty());
        assert!(dance_beats(&[]).is_empty());
    }

    #[test]
    fn a_share_is_slow() {
        let speed = [0.1, 0.16, 0.0, 0.2].map(|metres_per_second| metres_per_second / 60.0);
        assert_eq!(slow_share(&speed, 60.0), 0.5);
        assert_eq!(slow_share(&[], 60.0), 0.0);
    }

    /// Score of a beat `d` frames away.
    fn near(d: f64) -> f64 {
        (-d * d / 18.0).exp()
    }

    #[test]
    fn the_score_counts_the_nearest_of_the_others() {
        let score = beat_align_score(&[10, 50], &[13, 49, 120]);
        close(score, (near(3.0) + near(1.0)) / 2.0);
        assert_eq!(beat_align_score(&[10], &[]), 0.0);
        assert_eq!(beat_align_score(&[], &[10]), 0.0);
    }

    #[test]
    fn beats_align_where_both_kinds_are_near() {
        let align = |music: &[usize], dance: &[usize]| mutual_beat_alignment(music, dance, 10..50);
        assert_eq!(align(&[20, 90], &[20, 80]), Some(1.0));
        assert_eq!(align(&[], &[20]), Some(0.0));
        assert_eq!(align(&[5, 60], &[5, 60]), None);
        // The second dance beat is at no beat of the music.
        let found = align(&[20], &[21, 40]).unwrap();
        close(found, (2.0 * near(1.0) + near(20.0)) / 3.0);
        // A beat outside is a neighbour still.
        close(align(&[48], &[51]).unwrap(), near(3.0));
    }
}
