//! The seam between a motion and one that continues it: no jump in pose, none in speed.

use glam::{DVec3, Quat, Vec3};

use crate::{
    animation::{Animation, FrameQueue},
    smooth::hermite,
};

/// Seconds over which the difference between two motions at their seam is blended out.
const BLEND: f64 = 0.5;

/// The pose and speed with which a motion would go on in the frame after its last.
#[derive(Clone, Debug, PartialEq)]
pub struct Seam {
    /// World position of the root, metres.
    pub root: Vec3,
    /// Velocity of the root, metres a second.
    pub velocity: Vec3,
    /// Local unit quaternions of all joints.
    pub rotations: Vec<Quat>,
    /// Angular velocities of all joints in the frames of their parents, radians a second.
    pub spins: Vec<Vec3>,
}

impl Seam {
    /// Continues a motion at `fps` from its last two frames.
    pub(crate) fn after([before, last]: [(Vec3, &[Quat]); 2], fps: u32) -> Self {
        let fps = fps.max(1) as f32;
        let pairs = || before.1.iter().zip(last.1);
        let turns = || pairs().map(|(&before, &last)| turn(before, last));
        Self {
            root: 2.0 * last.0 - before.0,
            velocity: (last.0 - before.0) * fps,
            rotations: turns().zip(last.1).map(|(turn, &last)| turned(last, turn)).collect(),
            spins: turns().map(|turn| turn * fps).collect(),
        }
    }
}

/// Returns the rotation vector that takes one rotation to another, the shorter way.
pub(crate) fn turn(from: Quat, to: Quat) -> Vec3 {
    let difference = to * from.inverse();
    let shorter = if difference.w < 0.0 { -difference } else { difference };
    shorter.normalize().to_scaled_axis()
}

fn turned(rotation: Quat, turn: Vec3) -> Quat {
    (Quat::from_scaled_axis(turn) * rotation).normalize()
}

/// Returns the rate at which a rotation vector changes while its rotation turns with `spin`: the
/// inverse of the left Jacobian of the rotation group. They are equal for small vectors alone.
fn rate_of(vector: Vec3, spin: Vec3) -> Vec3 {
    let angle = vector.length();
    // 1 / 12 is the limit for small angles.
    let share = match angle > 1e-2 {
        true => (1.0 / angle - 0.5 / (0.5 * angle).tan()) / angle,
        false => 1.0 / 12.0,
    };
    spin - 0.5 * vector.cross(spin) + share * vector.cross(vector.cross(spin))
}

/// Blends the first frames of a motion from the seam with the one before it.
#[derive(Clone, Debug)]
pub(crate) struct SeamBlend {
    seam: Seam,
    kept: Animation,
    /// Difference of the root and of every joint at the seam, and its change a frame.
    differences: Vec<(DVec3, DVec3)>,
    done: usize,
    length: usize,
}

impl SeamBlend {
    /// For a motion at `fps`.
    pub(crate) fn new(seam: Seam, fps: u32) -> Self {
        let length = (BLEND * f64::from(fps)).round() as usize;
        let (kept, differences) = (Animation::empty(fps), Vec::new());
        Self { seam, kept, differences, done: 0, length }
    }

    /// Takes the next frames; returns them from the second frame on, whose speed is known then.
    pub(crate) fn push(&mut self, animation: Animation) -> Animation {
        self.kept.push_frames(animation);
        match self.kept.root.len() {
            0 | 1 if self.done == 0 => Animation::empty(self.kept.fps),
            _ => self.end(),
        }
    }

    /// Returns the rest.
    pub(crate) fn end(&mut self) -> Animation {
        if self.differences.is_empty() && !self.kept.root.is_empty() {
            self.differences = self.measure();
        }
        let mut animation = self.kept.take_frames(self.kept.root.len());
        for (root, rotations) in animation.root.iter_mut().zip(&mut animation.rotations) {
            if self.done < self.length {
                let (at, length) = (self.done as f64, self.length as f64);
                let left = |&difference: &(DVec3, DVec3)| {
                    hermite(difference, (DVec3::ZERO, DVec3::ZERO), at, length).as_vec3()
                };
                let mut left = self.differences.iter().map(left);
                *root += left.next().unwrap_or_default();
                for (rotation, left) in rotations.iter_mut().zip(left) {
                    *rotation = turned(*rotation, left);
                }
            }
            self.done += 1;
        }
        animation
    }

    fn measure(&self) -> Vec<(DVec3, DVec3)> {
        let Animation { fps, root, rotations } = &self.kept;
        let (fps, next) = ((*fps).max(1) as f32, 1.min(root.len() - 1));
        let seam = &self.seam;
        let moves = (seam.root - root[0], seam.velocity / fps - (root[next] - root[0]));
        let wanted = seam.rotations.iter().zip(&seam.spins);
        let own = rotations[0].iter().zip(&rotations[next]);
        let turns = wanted.zip(own).map(|((&wanted, &spin), (&first, &second))| {
            let difference = turn(first, wanted);
            // The motion's own spin is turned by the difference.
            let own = Quat::from_scaled_axis(difference) * turn(first, second);
            (difference, rate_of(difference, spin / fps - own))
        });
        let all = std::iter::once(moves).chain(turns);
        all.map(|(difference, rate)| (difference.as_dvec3(), rate.as_dvec3())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn swinging(frames: std::ops::Range<usize>, phase: f32) -> Animation {
        let at = |frame: usize| (3.0 * frame as f32 / 60.0 + phase).sin();
        Animation {
            fps: 60,
            root: frames.clone().map(|frame| Vec3::new(at(frame), 1.0, 0.0)).collect(),
            rotations: frames.map(|frame| vec![Quat::from_rotation_x(at(frame))]).collect(),
        }
    }

    fn blended(next: &Animation, seam: Seam, piece: usize) -> Animation {
        let mut blend = SeamBlend::new(seam, 60);
        let (mut rest, mut done) = (next.clone(), Animation::empty(60));
        while !rest.root.is_empty() {
            let count = piece.min(rest.root.len());
            done.push_frames(blend.push(rest.take_frames(count)));
        }
        done.push_frames(blend.end());
        done
    }

    #[test]
    fn pose_and_speed_go_on_and_the_motion_comes_back_to_its_own() {
        let first = swinging(0..60, 0.0);
        let next = swinging(60..160, 0.9);
        let last = [58, 59].map(|frame| (first.root[frame], &first.rotations[frame][..]));
        for piece in [1, 2, 100] {
            let after = blended(&next, Seam::after(last, 60), piece);
            assert_eq!(after.root.len(), 100);
            let path: Vec<f32> = first.root.iter().chain(&after.root).map(|at| at.x).collect();
            let angles = first.rotations.iter().chain(&after.rotations);
            let angles: Vec<f32> = angles.map(|pose| pose[0].to_scaled_axis().x).collect();
            for curve in [path, angles] {
                for (frame, three) in curve.windows(3).enumerate() {
                    // Inside, acceleration is 9 / s^2, and the blend's own some more.
                    let change = (three[2] - 2.0 * three[1] + three[0]).abs();
                    assert!(change < 0.009, "frame {frame}: {change}");
                }
            }
            assert_eq!(after.root[30..], next.root[30..]);
            assert_eq!(after.rotations[30..], next.rotations[30..]);
        }
    }

    #[test]
    fn the_rate_of_a_rotation_vector_is_that_of_its_rotation() {
        let spin = Vec3::new(0.3, -0.8, 0.5);
        for vector in [Vec3::ZERO, Vec3::X * 0.005, Vec3::new(0.4, 1.0, -0.2), Vec3::Y * 3.0] {
            let step = 1e-3;
            let later = Quat::from_scaled_axis(spin * step) * Quat::from_scaled_axis(vector);
            let found = (turn(Quat::IDENTITY, later) - vector) / step;
            assert!((found - rate_of(vector, spin)).length() < 0.01, "{vector}: {found}");
        }
    }

    #[test]
    fn a_motion_of_one_frame_begins_where_the_other_ended() {
        let first = swinging(0..2, 0.0);
        let last = [0, 1].map(|frame| (first.root[frame], &first.rotations[frame][..]));
        let seam = Seam::after(last, 60);
        let after = blended(&swinging(60..61, 0.0), seam.clone(), 1);
        assert!((after.root[0] - seam.root).length() < 1e-6);
        assert!(blended(&Animation::empty(60), seam, 1).root.is_empty());
    }
}
