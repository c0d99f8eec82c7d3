//! BVH: the skeleton as a hierarchy, and a line of channels per frame.
//!
//! y up, right-handed, the rest pose heading for +z, like the JSON. The root's OFFSET is zero, so
//! that its position channels are world positions whether a program adds the offset to them or not.
//! Rotation channels are applied in the order in which they are written, which is a joint's own
//! ([`RotationOrder::of_joint`]). BVH has no rest rotations: axes are parallel to the world's.

use std::{
    fmt::{self, Write},
    str::FromStr,
};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{
    decimal::push_decimal,
    error::FormatError,
    euler::RotationOrder,
    motion::{GeneratedMotion, MotionSize},
    rig::Rig,
    target::TargetSkeleton,
};

/// The unit of lengths in a BVH file. The format does not name one; most programs expect
/// centimetres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub enum BvhUnit {
    /// Centimetres (`cm`).
    #[default]
    #[serde(rename = "cm")]
    Centimetre,
    /// Metres (`m`).
    #[serde(rename = "m")]
    Metre,
}

impl BvhUnit {
    /// Returns the units per metre.
    fn per_metre(self) -> f64 {
        match self {
            Self::Centimetre => 100.0,
            Self::Metre => 1.0,
        }
    }

    /// Returns the decimals that hold a micrometre.
    fn decimals(self) -> usize {
        match self {
            Self::Centimetre => 4,
            Self::Metre => 6,
        }
    }
}

impl FromStr for BvhUnit {
    type Err = FormatError;

    fn from_str(name: &str) -> Result<Self, FormatError> {
        match name {
            "cm" => Ok(Self::Centimetre),
            "m" => Ok(Self::Metre),
            _ => {
                Err(FormatError::Choice { name: "bvh_unit", got: name.into(), accepted: "cm or m" })
            }
        }
    }
}

/// About the bytes of a motion as BVH.
pub(crate) fn bvh_bytes(size: MotionSize) -> usize {
    let joints = size.joints;
    // Three angles of a rotation take about nine bytes each.
    200 * joints + 30 * (joints + 1) * size.frames
}

/// Writes a motion as BVH on the model's own skeleton.
///
/// # Errors
/// As [`to_bvh_for`].
pub fn to_bvh(motion: &GeneratedMotion, unit: BvhUnit) -> Result<String, FormatError> {
    to_bvh_for(motion, unit, TargetSkeleton::Smpl)
}

/// Writes a motion as BVH on a skeleton that characters and programs know.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity,
/// [`FormatError::Skeleton`] if the model has joints that the target does not know.
pub fn to_bvh_for(
    motion: &GeneratedMotion,
    unit: BvhUnit,
    target: TargetSkeleton,
) -> Result<String, FormatError> {
    motion.check()?;
    let rig = Rig::new(&motion.skeleton, target, false)?;
    let bones = rig.bones.len();
    let mut writer = BvhWriter {
        text: String::with_capacity(bvh_bytes(motion.size())),
        motion,
        rig: &rig,
        order: Vec::with_capacity(bones),
        unit,
    };
    writer.text.push_str("HIERARCHY\n");
    writer.bone(0, 0)?;
    writer.frames()?;
    Ok(writer.text)
}

struct BvhWriter<'a> {
    text: String,
    motion: &'a GeneratedMotion,
    rig: &'a Rig,
    /// Bones in the order of the hierarchy, which is that of the channels.
    order: Vec<(usize, RotationOrder)>,
    unit: BvhUnit,
}

impl BvhWriter<'_> {
    fn bone(&mut self, index: usize, depth: usize) -> fmt::Result {
        let bone = &self.rig.bones[index];
        let joint = bone.joint.and_then(|joint| self.motion.skeleton.joints.get(joint));
        let order = RotationOrder::of_joint(joint.map_or("", String::as_str));
        self.order.push((index, order));
        let indent = "\t".repeat(depth);
        let kind = if depth == 0 { "ROOT" } else { "JOINT" };
        writeln!(self.text, "{indent}{kind} {}\n{indent}{{", token(&bone.name))?;
        let moves = self.moves(index);
        self.offset(&indent, if moves { DVec3::ZERO } else { bone.offset })?;
        let channels = if moves { "6 Xposition Yposition Zposition" } else { "3" };
        write!(self.text, "{indent}\tCHANNELS {channels}")?;
        for axis in order.0 {
            write!(self.text, " {}rotation", ["X", "Y", "Z"][axis])?;
        }
        self.text.push('\n');
        let children: Vec<usize> = self.rig.children(index).collect();
        for &child in &children {
            self.bone(child, depth + 1)?;
        }
        if children.is_empty() {
            writeln!(self.text, "{indent}\tEnd Site\n{indent}\t{{")?;
            let end = self.rig.end(index, &self.motion.skeleton);
            self.offset(&format!("{indent}\t"), end)?;
            writeln!(self.text, "{indent}\t}}")?;
        }
        writeln!(self.text, "{indent}}}")
    }

    /// Whether a bone has position channels: the hips, and a root on the floor above them.
    fn moves(&self, bone: usize) -> bool {
        bone == 0 || bone == self.rig.hips()
    }

    fn offset(&mut self, indent: &str, offset: DVec3) -> fmt::Result {
        write!(self.text, "{indent}\tOFFSET")?;
        self.lengths(offset)?;
        self.text.push('\n');
        Ok(())
    }

    fn frames(&mut self) -> fmt::Result {
        let animation = &self.motion.animation;
        let frame_time = 1.0 / f64::from(animation.fps);
        let frames = animation.root.len();
        writeln!(self.text, "MOTION\nFrames: {frames}\nFrame Time: {frame_time:.8}")?;
        // The first angles are those nearest to 0: within half a turn.
        let mut angles = vec![[0.0; 3]; self.order.len()];
        for (&root, rotations) in animation.root.iter().zip(&animation.rotations) {
            let start = self.text.len();
            for (place, angles) in angles.iter_mut().enumerate() {
                let (bone, order) = self.order[place];
                if self.moves(bone) {
                    let is_hips = bone == self.rig.hips();
                    self.lengths(if is_hips { root.as_dvec3() } else { DVec3::ZERO })?;
                }
                *angles = order.nearest_angles(self.rig.rotation(bone, rotations), *angles);
                for angle in *angles {
                    // 1e-4 degrees move a hand by a few micrometres.
                    self.text.push(' ');
                    push_decimal(&mut self.text, angle.to_degrees(), 4)?;
                }
            }
            // Every number comes with a space in front; a line starts without.
            self.text.remove(start);
            self.text.push('\n');
        }
        Ok(())
    }

    fn lengths(&mut self, metres: DVec3) -> fmt::Result {
        let decimals = self.unit.decimals();
        for value in (metres * self.unit.per_metre()).to_array() {
            self.text.push(' ');
            push_decimal(&mut self.text, value, decimals)?;
        }
        Ok(())
    }
}

/// Turns a name into one that BVH can hold: one word without braces, and without colons, which
/// three.js takes out of a bone's name but not out of its tracks.
fn token(name: &str) -> String {
    let fits = |c: char| !c.is_whitespace() && !c.is_control() && !matches!(c, '{' | '}');
    let kept = name.chars().filter(|&c| c != ':');
    kept.map(|c| if fits(c) { c } else { '_' }).collect()
}
