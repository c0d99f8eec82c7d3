//! Poses of the body models SMPL, SMPL-H and SMPL-X as rotations of SMPL's joints. Fingers and face
//! are left out, SMPL's own hands rest.

use std::ops::RangeInclusive;

use bailando::motion::Animation;
use glam::{Quat, Vec3};

use super::{
    FPS, JOINTS,
    skeletons::{self, BODY, SMPL_H, SMPL_X},
};

/// Metres, centimetres and millimetres in a metre.
const UNITS: [f32; 3] = [1.0, 100.0, 1_000.0];
/// Sizes of people beside the model's.
const PERSON: RangeInclusive<f32> = 0.6..=1.6;
/// Metres: no dancer's pelvis moves that far along every axis, up and down included.
const FARTHEST: f32 = 5.0;
/// Metres: the pelvis of a dancer moves further than that along some axis, unless it is fixed.
const NEAREST: f32 = 0.02;
/// Frames from which on a path is judged.
const JUDGED: usize = 60;

/// Axis-angle rotations and the root's path, as files hold them.
pub(super) struct BodyPoses {
    /// `[frames, joints, 3]` or `[frames, 3 joints]`, and the values.
    pub(super) poses: (Vec<usize>, Vec<f32>),
    /// `[frames, 3]`, and the values.
    pub(super) path: (Vec<usize>, Vec<f32>),
    /// Units of the path in a metre, times the dancer's size; none where the file does not say.
    pub(super) scaling: Option<f32>,
}

impl BodyPoses {
    /// Returns the motion of SMPL's joints, the path in metres.
    ///
    /// # Errors
    /// What does not fit, in words.
    pub(super) fn animation(&self) -> Result<Animation, String> {
        let (shape, turns) = &self.poses;
        let layout = skeletons::layout(shape);
        let layout = layout.filter(|(_, joints)| [JOINTS, BODY, SMPL_H, SMPL_X].contains(joints));
        let Some((frames, joints)) = layout else {
            let expected = "[frames, 72] of SMPL, [frames, 156] of SMPL-H or [frames, 165] of \
                            SMPL-X";
            return Err(skeletons::refusal("the poses have shape", shape, expected));
        };
        if self.path.0 != [frames, 3] {
            let found = &self.path.0;
            return Err(format!("the root's path has shape {found:?}, expected [{frames}, 3]"));
        }
        let root = self.root()?;
        let pose = |turns: &[f32]| -> Vec<Quat> {
            let body = vectors(turns).take(joints.min(JOINTS)).enumerate();
            // From the wrists on, only SMPL's own joints are SMPL's.
            let body = body.map(|(joint, turn)| match joint < BODY || joints == JOINTS {
                true => Quat::from_scaled_axis(turn),
                false => Quat::IDENTITY,
            });
            body.chain(std::iter::repeat(Quat::IDENTITY)).take(JOINTS).collect()
        };
        Ok(Animation {
            fps: FPS as u32,
            root,
            rotations: turns.chunks_exact(3 * joints).map(pose).collect(),
        })
    }

    /// Returns the root's path in metres, refusing one that cannot be.
    fn root(&self) -> Result<Vec<Vec3>, String> {
        let scaling = self.scaling.unwrap_or(1.0);
        if !UNITS.iter().any(|unit| PERSON.contains(&(scaling / unit))) {
            return Err(format!(
                "smpl_scaling is {scaling}: expected about 1 (a path in metres), 100 (in \
                 centimetres, as AIST++ has) or 1000, by the dancer's size"
            ));
        }
        let path: Vec<Vec3> = vectors(&self.path.1).map(|place| place / scaling).collect();
        let bounds = path.iter().filter(|place| place.is_finite()).copied();
        let (low, high) = bounds.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), at| {
            (low.min(at), high.max(at))
        });
        let moved = high - low;
        let far = moved.min_element();
        if far > FARTHEST && far.is_finite() {
            let why = match self.scaling {
                None => "smpl_scaling is missing: add it, about 93 for a path in centimetres",
                Some(_) => "check smpl_scaling, about 93 for a path in centimetres",
            };
            return Err(format!(
                "the root moves by {far:.0} m or more along every axis, which no dancer does; {why}"
            ));
        }
        let near = moved.max_element();
        if path.len() >= JUDGED && near > 0.0 && near < NEAREST {
            return Err(format!(
                "the root moves by {:.0} mm at most, which no dancer does: with smpl_scaling \
                 {scaling} the path must be in that unit",
                1_000.0 * near
            ));
        }
        Ok(path)
    }
}

fn vectors(values: &[f32]) -> impl Iterator<Item = Vec3> {
    values.as_chunks::<3>().0.iter().map(|&[x, y, z]| Vec3::new(x, y, z))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAMES: usize = 120;

    /// Poses of so many joints; the root sways by half a metre, in units of `unit`.
    fn body(joints: usize, unit: f32, scaling: Option<f32>) -> BodyPoses {
        let turn = |place: usize| (place % (3 * joints)) as f32 / 1_000.0;
        let path = |place: usize| unit * (place as f32 / 30.0).sin() / 4.0;
        BodyPoses {
            poses: (vec![FRAMES, 3 * joints], (0..3 * joints * FRAMES).map(turn).collect()),
            path: (vec![FRAMES, 3], (0..3 * FRAMES).map(path).collect()),
            scaling,
        }
    }

    #[test]
    fn the_body_of_every_model_is_the_same() {
        let smpl = body(JOINTS, 1.0, None).animation().unwrap();
        for joints in [SMPL_H, SMPL_X] {
            let mut larger = body(joints, 1.0, None).animation().unwrap();
            let hands = larger.rotations[7].split_off(BODY);
            assert_eq!(hands, [Quat::IDENTITY; 2]);
            assert_eq!(larger.rotations[7], smpl.rotations[7][..BODY], "{joints}");
            assert_eq!(larger.root, smpl.root);
        }
        let mut cube = body(SMPL_H, 1.0, None);
        cube.poses.0 = vec![FRAMES, SMPL_H, 3];
        assert_eq!(cube.animation().unwrap(), body(SMPL_H, 1.0, None).animation().unwrap());
    }

    #[test]
    fn other_skeletons_are_named() {
        let refused = body(17, 1.0, None).animation().unwrap_err();
        assert!(refused.contains("17 joints are those of COCO"), "{refused}");
        let mut short = body(JOINTS, 1.0, None);
        short.path.0 = vec![FRAMES - 1, 3];
        assert!(short.animation().unwrap_err().contains("[119, 3], expected [120, 3]"));
    }

    #[test]
    fn scales_must_be_those_of_people() {
        for (unit, scaling) in [(1.0, None), (1.0, Some(0.93)), (93.0, Some(93.0))] {
            body(JOINTS, unit, scaling).animation().unwrap();
        }
        for (unit, scaling, words) in [
            (93.0, None, "smpl_scaling is missing"),
            (93.0, Some(1.0), "check smpl_scaling"),
            (1.0, Some(93.0), "mm at most"),
            (1.0, Some(7.0), "smpl_scaling is 7: expected about 1"),
            (1.0, Some(0.0), "smpl_scaling is 0"),
            (1.0, Some(f32::NAN), "smpl_scaling is NaN"),
        ] {
            let refused = body(JOINTS, unit, scaling).animation().unwrap_err();
            assert!(refused.contains(words), "{refused}");
        }
        let mut fixed = body(JOINTS, 1.0, None);
        fixed.path.1.fill(0.0);
        fixed.animation().unwrap();
    }
}
