//! What all recordings have done to them: turned upright, 60 frames a second, on the floor.

use std::{f32::consts::FRAC_PI_2, path::Path};

use bailando::motion::{
    Animation, Positions, STANDING_HEIGHT, Skeleton, forward, lower_foot_heights,
};
use glam::{DVec3, Quat, Vec3};

use super::super::{DataError, FPS, check::up_direction, load::broken_frame};

/// Frames a second that cameras and suits have.
const RATES: std::ops::RangeInclusive<f64> = 1.0..=1_000.0;
/// Share of the body's direction that must be along an axis.
const UPRIGHT: f64 = 0.5;

/// Rotations of our skeleton at the rate that they were recorded with.
pub(super) struct Recorded {
    pub(super) animation: Animation,
    /// Frames a second.
    pub(super) rate: f64,
}

impl Recorded {
    /// Returns the joints of the figure standing on the floor, 60 frames a second. `path` is what
    /// errors call it.
    pub(super) fn stand(
        mut self,
        path: &Path,
        skeleton: &Skeleton,
    ) -> Result<Positions, DataError> {
        let shape = |what: String| DataError::Shape { path: path.to_owned(), what };
        let joints = |animation: &Animation| {
            forward(skeleton, animation)
                .map_err(|source| DataError::Motion { path: path.to_owned(), source })
        };
        if !RATES.contains(&self.rate) {
            return Err(shape(format!("it has {} frames a second", self.rate)));
        }
        let raw = joints(&self.animation)?;
        if let Some(frame) = broken_frame(&raw) {
            return Err(DataError::NotFinite { path: path.to_owned(), frame });
        }
        if raw.is_empty() {
            return Err(shape("it has no frames".into()));
        }
        let turn = upright(up_direction(&raw, skeleton)).ok_or_else(|| {
            let what = "the figure lies, rolls or turns over most of the time: which way is up \
                        cannot be told";
            shape(what.into())
        })?;
        self.turn(turn);
        let mut positions = joints(&self.at_frame_rate())?;
        let mut heights = lower_foot_heights(&positions, skeleton);
        heights.sort_by(f32::total_cmp);
        let low = heights.get(heights.len() / 20).copied().unwrap_or_default();
        for mut pose in positions.outer_iter_mut() {
            pose.column_mut(1).mapv_inplace(|height| height + STANDING_HEIGHT - low);
        }
        Ok(positions)
    }

    fn turn(&mut self, turn: Quat) {
        for root in &mut self.animation.root {
            *root = turn * *root;
        }
        for pose in &mut self.animation.rotations {
            if let Some(pelvis) = pose.first_mut() {
                *pelvis = turn * *pelvis;
            }
        }
    }

    /// Spherical interpolation of rotations, linear of the root; the last frame is the last one
    /// within the recording.
    fn at_frame_rate(&self) -> Animation {
        let Animation { root, rotations, .. } = &self.animation;
        let step = self.rate / FPS as f64;
        let last = root.len().saturating_sub(1);
        let frames = (last as f64 / step + 1e-6) as usize + 1;
        let places = (0..frames).map(|frame| {
            let time = frame as f64 * step;
            let at = (time as usize).min(last);
            (at, (at + 1).min(last), (time - at as f64) as f32)
        });
        let mut found = Animation { fps: FPS as u32, root: Vec::new(), rotations: Vec::new() };
        for (at, next, share) in places {
            let root = |frame: usize| root.get(frame).copied().unwrap_or(Vec3::ZERO);
            let pose = |frame: usize| rotations.get(frame).map_or(&[] as &[Quat], Vec::as_slice);
            found.root.push(root(at).lerp(root(next), share));
            let turns = pose(at).iter().zip(pose(next));
            found.rotations.push(turns.map(|(a, b)| a.slerp(*b, share)).collect());
        }
        found
    }
}

/// Returns the quarter or half turn that brings the axis nearest to `up` to +y.
fn upright(up: DVec3) -> Option<Quat> {
    let axis = up.abs().max_position();
    let value = up[axis];
    let quarter = FRAC_PI_2 * value.signum() as f32;
    (value.abs() >= UPRIGHT).then(|| match (axis, value > 0.0) {
        (0, _) => Quat::from_rotation_z(quarter),
        (1, true) => Quat::IDENTITY,
        (1, false) => Quat::from_rotation_x(2.0 * FRAC_PI_2),
        _ => Quat::from_rotation_x(-quarter),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_is_turned_up() {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            for up in [axis, -axis] {
                let turned = upright(0.8 * up).unwrap() * up.as_vec3();
                assert!(turned.distance(Vec3::Y) < 1e-6, "{up}: {turned}");
            }
        }
        assert!(upright(DVec3::splat(0.3)).is_none());
    }

    #[test]
    fn frames_keep_their_times() {
        let recorded = |rate: f64, frames: usize| Recorded {
            animation: Animation {
                fps: 60,
                root: (0..frames).map(|n| Vec3::X * (n as f64 / rate) as f32).collect(),
                rotations: (0..frames)
                    .map(|n| vec![Quat::from_rotation_y((n as f64 / rate) as f32)])
                    .collect(),
            },
            rate,
        };
        for (rate, frames, expected) in [(30.0, 31, 61), (120.0, 121, 61), (29.97, 60, 119)] {
            let found = recorded(rate, frames).at_frame_rate();
            assert_eq!(found.root.len(), expected, "{rate}");
            for (frame, (root, pose)) in found.root.iter().zip(&found.rotations).enumerate() {
                let seconds = frame as f32 / 60.0;
                assert!((root.x - seconds).abs() < 1e-4, "{rate}: {root} at {seconds}");
                // Half the sine: an angle that comes of a cosine near 1 is known to 1e-3 only.
                let apart = (pose[0] * Quat::from_rotation_y(-seconds)).xyz().length();
                assert!(apart < 5e-4, "{rate}: {apart} at {seconds}");
            }
        }
    }
}
