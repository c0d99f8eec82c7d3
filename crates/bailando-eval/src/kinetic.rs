//! Kinetic features (Onuma et al. 2008): energy of every joint, 24 x (horizontal, vertical,
//! acceleration). METRICS.md, "Kinetic features".

use std::ops::Range;

use glam::DVec3;

use crate::body::{FRAMES_PER_SECOND, JOINTS, Pose};

/// Number of kinetic features.
pub const KINETIC_FEATURES: usize = 3 * JOINTS;
/// Velocities and accelerations are averaged over this many frames to either side.
const REACH: isize = 2;

/// Which form the acceleration term takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum KineticForm {
    /// As in every published `FID_k` and `Div_k`: the original toolbox divides only the second term
    /// of the earlier velocity by the frame time, so that the feature depends on the dancer's
    /// place.
    #[default]
    Published,
    /// The second difference that was meant. Not comparable with published figures.
    Corrected,
}

/// Computes the 72 features of a clip, joint by joint: horizontal and vertical energy,
/// acceleration.
///
/// The published acceleration depends on the place: move the clip to its first root beforehand.
#[must_use]
pub fn kinetic_features(clip: &[Pose], form: KineticForm) -> [f64; KINETIC_FEATURES] {
    let mut features = [0.0; KINETIC_FEATURES];
    if clip.len() < 2 {
        return features;
    }
    let steps = (clip.len() - 1) as f64;
    for (joint, triple) in features.chunks_exact_mut(3).enumerate() {
        let mut sums = [0.0; 3];
        for frame in 1..clip.len() {
            let velocity = mean_velocity(clip, joint, frame);
            sums[0] += velocity.x.powi(2) + velocity.z.powi(2);
            sums[1] += velocity.y.powi(2);
            sums[2] += mean_acceleration(clip, joint, frame, form).length();
        }
        for (feature, sum) in triple.iter_mut().zip(sums) {
            *feature = sum / steps;
        }
    }
    features
}

/// Frames `frame + j`, `j = -2..=2`, that have a frame before and `after` frames after them.
fn neighbours(frame: usize, frames: usize, after: usize) -> Range<usize> {
    let reach = REACH.unsigned_abs();
    let first = frame.saturating_sub(reach).max(1);
    let end = (frame + reach + 1).min(frames.saturating_sub(after));
    first..end.max(first)
}

fn mean(range: Range<usize>, value: impl Fn(usize) -> DVec3) -> DVec3 {
    let count = range.len();
    if count == 0 {
        return DVec3::ZERO;
    }
    range.map(value).sum::<DVec3>() / count as f64
}

fn mean_velocity(clip: &[Pose], joint: usize, frame: usize) -> DVec3 {
    mean(neighbours(frame, clip.len(), 0), |at| {
        (clip[at][joint] - clip[at - 1][joint]) * FRAMES_PER_SECOND
    })
}

fn mean_acceleration(clip: &[Pose], joint: usize, frame: usize, form: KineticForm) -> DVec3 {
    mean(neighbours(frame, clip.len(), 1), |at| {
        let [before, here, after] = [at - 1, at, at + 1].map(|frame| clip[frame][joint]);
        let later = (after - here) * FRAMES_PER_SECOND;
        let earlier = match form {
            KineticForm::Published => here - before * FRAMES_PER_SECOND,
            KineticForm::Corrected => (here - before) * FRAMES_PER_SECOND,
        };
        (later - earlier) * FRAMES_PER_SECOND
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::within;

    fn close(got: f64, expected: f64) {
        within(1e-9, got, expected);
    }

    const STEP: f64 = 1.0 / FRAMES_PER_SECOND;

    fn clip(frames: usize, place: impl Fn(f64) -> DVec3) -> Vec<Pose> {
        (0..frames).map(|frame| [place(frame as f64 * STEP); JOINTS]).collect()
    }

    #[test]
    fn steady_motion_has_the_squares_of_its_speeds() {
        let clip = clip(50, |t| DVec3::new(1.5, -0.5, 2.0) * t);
        let features = kinetic_features(&clip, KineticForm::Corrected);
        for triple in features.chunks_exact(3) {
            close(triple[0], 1.5 * 1.5 + 2.0 * 2.0);
            close(triple[1], 0.25);
            close(triple[2], 0.0);
        }
    }

    #[test]
    fn falling_has_its_acceleration_in_the_corrected_form() {
        // The last frame has neighbours before it only: an average of a constant is that constant.
        let clip = clip(30, |t| DVec3::Y * (-0.5 * 9.81 * t * t));
        let features = kinetic_features(&clip, KineticForm::Corrected);
        close(features[2], 9.81);
    }

    #[test]
    fn the_published_form_follows_its_formula_for_a_still_joint() {
        // v2 = 0, v1 = p - 60 p = -59 p, so a = 59 p * 60.
        let place = DVec3::new(0.0, 3.0, 4.0);
        let clip = clip(10, |_| place);
        let features = kinetic_features(&clip, KineticForm::Published);
        close(features[2], 59.0 * 60.0 * 5.0);
        close(kinetic_features(&clip, KineticForm::Corrected)[2], 0.0);
    }

    /// Compares with the definition and its conditions on `j`, on an irregular motion.
    #[test]
    fn ends_use_the_neighbours_that_exist() {
        let place = |t: f64| DVec3::new((7.0 * t).sin(), (3.0 * t).cos(), (11.0 * t).sin() * t);
        let clip = clip(9, place);
        let p = |frame: isize| clip[frame as usize][5];
        let total = clip.len() as isize;
        let (mut horizontal, mut acceleration) = (0.0, 0.0);
        for i in 1..total {
            let at: Vec<isize> = (-2..=2).filter(|j| i + j > 0 && i + j < total).collect();
            let u = at.iter().map(|j| (p(i + j) - p(i + j - 1)) / STEP);
            let u = u.sum::<DVec3>() / at.len() as f64;
            horizontal += u.x * u.x + u.z * u.z;
            let at: Vec<isize> = (-2..=2).filter(|j| i + j > 0 && i + j + 1 < total).collect();
            let a = at.iter().map(|j| {
                let v2 = (p(i + j + 1) - p(i + j)) / STEP;
                let v1 = p(i + j) - p(i + j - 1) / STEP;
                (v2 - v1) / STEP
            });
            acceleration += (a.sum::<DVec3>() / at.len() as f64).length();
        }
        let features = kinetic_features(&clip, KineticForm::Published);
        close(features[15], horizontal / (total - 1) as f64);
        close(features[17], acceleration / (total - 1) as f64);
    }
}
