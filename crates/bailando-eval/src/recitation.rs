//! The share of a motion that repeats a training take (METRICS.md, "Recitation").

use crate::body::{JOINTS, Motion, Pose, in_dancer_frame};

/// Frames of a window: 2 s.
const WINDOW: usize = 120;
/// Frames from one window of a measured motion to the next: 1 s.
const STRIDE: usize = 60;
/// Frames of a part of a window, whose mean poses rule out most comparisons.
const PART: usize = 30;
/// Mean joint distance up to which two windows are the same, metres.
const SAME: f32 = 0.05;

/// Coordinates x, y, z of all joints, one axis after the other, so that the compiler computes many
/// distances at a time.
type Flat = [[f32; JOINTS]; 3];

/// Every window, at any frame, of the motions that a model was trained on.
#[derive(Clone, Debug, Default)]
pub(crate) struct TrainingTakes {
    takes: Vec<Take>,
}

#[derive(Clone, Debug)]
struct Take {
    poses: Vec<Flat>,
    /// Mean pose of the `PART` frames from each frame on.
    parts: Vec<Flat>,
    /// Mean pose of the `WINDOW` frames from each frame on.
    windows: Vec<Flat>,
    /// Distance that this mean pose has travelled since the first frame.
    travelled: Vec<f64>,
}

impl TrainingTakes {
    /// Indexes some motions; those shorter than 2 s have no window.
    pub(crate) fn new<'a>(takes: impl IntoIterator<Item = &'a Motion>) -> Self {
        let takes = takes.into_iter().map(|take| Take::new(take.poses()));
        Self { takes: takes.collect() }
    }

    /// Counts the 2 s windows of a motion, one a second: those within 5 cm mean joint distance of
    /// any window of a take, root and heading removed frame by frame, and all.
    pub(crate) fn recited(&self, poses: &[Pose]) -> (usize, usize) {
        let motion = Take::new(poses);
        let starts = (0..motion.windows.len()).step_by(STRIDE);
        let windows = starts.len();
        let known = |&start: &usize| self.takes.iter().any(|take| take.holds(&motion, start));
        (starts.filter(known).count(), windows)
    }
}

impl Take {
    fn new(poses: &[Pose]) -> Self {
        let poses: Vec<Flat> = poses.iter().map(flat).collect();
        let windows = running_means(&poses, WINDOW);
        let mut travelled = Vec::with_capacity(windows.len());
        let mut so_far = 0.0;
        for (at, window) in windows.iter().enumerate() {
            so_far += f64::from(distance(window, &windows[at.saturating_sub(1)]));
            travelled.push(so_far);
        }
        Self { parts: running_means(&poses, PART), poses, windows, travelled }
    }

    /// Whether any window of this take is the same as that of `other` at `start`.
    ///
    /// The mean distance of two windows is never less than the distance of their mean poses, and
    /// mean poses travel slowly: a distant one stays too far for many frames.
    fn holds(&self, other: &Self, start: usize) -> bool {
        let wanted = &other.windows[start];
        let mut own = 0;
        while own < self.windows.len() {
            let excess = distance(&self.windows[own], wanted) - SAME;
            if excess > 0.0 {
                let reached = self.travelled[own] + f64::from(excess);
                let next = self.travelled.partition_point(|&travelled| travelled < reached);
                own = next.max(own + 1);
            } else if self.same(own, other, start) {
                return true;
            } else {
                own += 1;
            }
        }
        false
    }

    fn same(&self, own: usize, other: &Self, start: usize) -> bool {
        let part = |at: usize| distance(&self.parts[own + at], &other.parts[start + at]);
        let coarse: f32 = (0..WINDOW).step_by(PART).map(part).sum();
        if coarse * PART as f32 > SAME * WINDOW as f32 {
            return false;
        }
        let frames = self.poses[own..own + WINDOW].iter().zip(&other.poses[start..]);
        let exact: f32 = frames.map(|(a, b)| distance(a, b)).sum();
        exact <= SAME * WINDOW as f32
    }
}

/// Moves the root to the origin, and turns the pose so that its left points along x.
fn flat(pose: &Pose) -> Flat {
    let pose = in_dancer_frame(pose);
    [0, 1, 2].map(|axis| pose.map(|place| place[axis] as f32))
}

/// Mean joint distance, metres.
fn distance(a: &Flat, b: &Flat) -> f32 {
    let mut squares = [0.0_f32; JOINTS];
    for (one, other) in a.iter().zip(b) {
        for ((square, x), y) in squares.iter_mut().zip(one).zip(other) {
            *square += (x - y) * (x - y);
        }
    }
    squares.iter().map(|square| square.sqrt()).sum::<f32>() / JOINTS as f32
}

/// Returns the mean of the `length` poses from each frame on, summed in doubles against drift.
fn running_means(poses: &[Flat], length: usize) -> Vec<Flat> {
    if poses.len() < length {
        return Vec::new();
    }
    let mut sums = [[0.0_f64; JOINTS]; 3];
    let mut means = Vec::with_capacity(poses.len() - length + 1);
    for (frame, pose) in poses.iter().enumerate() {
        add(&mut sums, pose, 1.0);
        if frame + 1 >= length {
            means.push(sums.map(|axis| axis.map(|sum| (sum / length as f64) as f32)));
            add(&mut sums, &poses[frame + 1 - length], -1.0);
        }
    }
    means
}

fn add(sums: &mut [[f64; JOINTS]; 3], pose: &Flat, sign: f64) {
    for (sums, values) in sums.iter_mut().zip(pose) {
        for (sum, &value) in sums.iter_mut().zip(values) {
            *sum += sign * f64::from(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use ndarray::Array3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Random sways of all joints: smooth, never repeating.
    fn dance(frames: usize, seed: u64) -> Vec<Pose> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = || random.random_range(0.5..2.5_f64);
        let waves: [[f64; 3]; JOINTS] = std::array::from_fn(|_| [draw(), draw(), draw()]);
        let pose = |t: f64| {
            std::array::from_fn(|joint| {
                let side = if joint % 3 == 1 { 0.3 } else { -0.3 };
                let sway = DVec3::from_array(waves[joint].map(|w| 0.2 * (w * t + w).sin()));
                DVec3::new(side, 0.05 * joint as f64, 0.0) + sway
            })
        };
        (0..frames).map(|frame| pose(frame as f64 / 60.0)).collect()
    }

    fn motion(poses: &[Pose]) -> Motion {
        let positions = Array3::from_shape_fn((poses.len(), JOINTS, 3), |(frame, joint, axis)| {
            poses[frame][joint][axis] as f32
        });
        Motion::new("take", positions.view()).unwrap()
    }

    #[test]
    fn a_take_is_recognised_at_any_place_and_heading() {
        let take = dance(600, 1);
        let known = TrainingTakes::new([&motion(&dance(500, 2)), &motion(&take)]);
        let turn = DQuat::from_rotation_y(2.1);
        let elsewhere: Vec<Pose> = take[37..400]
            .iter()
            .map(|pose| pose.map(|place| turn * place + DVec3::new(3.0, 0.2, -1.0)))
            .collect();
        assert_eq!(known.recited(&elsewhere), (5, 5));
        assert_eq!(known.recited(&dance(363, 3)), (0, 5));
        assert_eq!(known.recited(&take[..119]), (0, 0));
    }

    #[test]
    fn the_limit_is_a_mean_distance_of_5_cm() {
        let take = dance(300, 4);
        let known = TrainingTakes::new([&motion(&take)]);
        // Half of the joints move by twice the distance; none of them sets root or heading.
        let off = |by: f64| -> Vec<Pose> {
            let shift = |pose: &Pose| {
                let mut pose = *pose;
                for place in &mut pose[3..=14] {
                    place.y += 2.0 * by;
                }
                pose
            };
            take.iter().map(shift).collect()
        };
        assert_eq!(known.recited(&off(0.0495)).0, 4);
        assert_eq!(known.recited(&off(0.0505)).0, 0);
    }

    /// Compares with the definition, without any shortcut, on windows around the limit.
    #[test]
    fn shortcuts_never_change_the_answer() {
        let take = dance(400, 5);
        let known = TrainingTakes::new([&motion(&take)]);
        let exact = |poses: &[Pose], start: usize| {
            let mean = |own: usize| {
                let frames = (0..WINDOW).map(|at| {
                    let one = flat(&take[own + at]);
                    distance(&one, &flat(&poses[start + at]))
                });
                frames.sum::<f32>() / WINDOW as f32
            };
            (0..=take.len() - WINDOW).any(|own| mean(own) <= SAME)
        };
        let mut recited = 0;
        for shift in 0..12 {
            // Ever later in the take, with ever more of another motion mixed in.
            let share = f64::from(shift) * 0.05;
            let mix = |(one, other): (&Pose, &Pose)| {
                std::array::from_fn(|joint| one[joint].lerp(other[joint], share))
            };
            let other = dance(400, 6);
            let poses: Vec<Pose> =
                take[10 * shift as usize..].iter().zip(&other).map(mix).collect();
            let starts = (0..=poses.len() - WINDOW).step_by(STRIDE);
            let expected = starts.filter(|&start| exact(&poses, start)).count();
            assert_eq!(known.recited(&poses).0, expected, "{shift}");
            recited += expected;
        }
        let some = recited > 4 && recited < 40;
        assert!(some, "{recited}: all or nothing tests little");
    }
}
