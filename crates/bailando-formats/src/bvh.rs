//! BVH: the skeleton as a hierarchy, and a line of channels per frame.
//!
//! y up, right-handed, the rest pose heading for +z, like the JSON. The root's OFFSET is zero, so
//! that its position channels are world positions whether a program adds the offset to them or not.
//! Rotation channels are written and applied in the order y, x, z (`R = Ry * Rx * Rz`), which every
//! joint shares.

use std::{
    fmt::{self, Write},
    str::FromStr,
};

use bailando_motion::Skeleton;
use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::{
    decimal::push_decimal, error::FormatError, euler::nearest_angles, motion::GeneratedMotion,
};

const ROTATION_CHANNELS: &str = "Yrotation Xrotation Zrotation";
/// Length of an End Site whose bone has none, metres.
const SHORTEST_END: f32 = 0.05;

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
    fn per_metre(self) -> f32 {
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
pub(crate) fn bvh_bytes(motion: &GeneratedMotion) -> usize {
    let joints = motion.skeleton.joints.len();
    // Three angles of a rotation take about nine bytes each.
    200 * joints + 30 * (joints + 1) * motion.animation.root.len()
}

/// Writes a motion as BVH.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity.
pub fn to_bvh(motion: &GeneratedMotion, unit: BvhUnit) -> Result<String, FormatError> {
    motion.check()?;
    let joints = motion.skeleton.joints.len();
    let mut writer = BvhWriter {
        text: String::with_capacity(bvh_bytes(motion)),
        skeleton: &motion.skeleton,
        order: Vec::with_capacity(joints),
        unit,
    };
    writer.text.push_str("HIERARCHY\n");
    writer.joint(0, 0)?;
    writer.motion(motion)?;
    Ok(writer.text)
}

struct BvhWriter<'a> {
    text: String,
    skeleton: &'a Skeleton,
    /// Joints in the order of the hierarchy, which is that of the channels.
    order: Vec<usize>,
    unit: BvhUnit,
}

impl BvhWriter<'_> {
    fn joint(&mut self, joint: usize, depth: usize) -> fmt::Result {
        self.order.push(joint);
        let indent = "\t".repeat(depth);
        let name = token(&self.skeleton.joints[joint]);
        let (kind, offset, channels) = if joint == 0 {
            ("ROOT", Vec3::ZERO, "6 Xposition Yposition Zposition ")
        } else {
            ("JOINT", self.skeleton.offset(joint), "3 ")
        };
        writeln!(self.text, "{indent}{kind} {name}\n{indent}{{")?;
        self.offset(&indent, offset)?;
        let text = &mut self.text;
        writeln!(text, "{indent}\tCHANNELS {channels}{ROTATION_CHANNELS}")?;
        let is_child = |child: &usize| self.skeleton.parent(*child) == Some(joint);
        let children: Vec<usize> =
            (joint + 1..self.skeleton.joints.len()).filter(is_child).collect();
        for &child in &children {
            self.joint(child, depth + 1)?;
        }
        if children.is_empty() {
            writeln!(self.text, "{indent}\tEnd Site\n{indent}\t{{")?;
            let end = self.end_of(joint);
            self.offset(&format!("{indent}\t"), end)?;
            writeln!(self.text, "{indent}\t}}")?;
        }
        writeln!(self.text, "{indent}}}")
    }

    fn offset(&mut self, indent: &str, offset: Vec3) -> fmt::Result {
        write!(self.text, "{indent}\tOFFSET")?;
        self.lengths(offset)?;
        self.text.push('\n');
        Ok(())
    }

    /// Returns the end of a leaf's bone. The last bone continues by its own length, so that
    /// programs which draw bones from joint to joint show hands and head; toes continue along the
    /// floor.
    fn end_of(&self, joint: usize) -> Vec3 {
        let bone = self.skeleton.offset(joint);
        let end = if self.skeleton.foot_joints().contains(&joint) {
            0.5 * bone.with_y(0.0)
        } else {
            bone
        };
        // Too short to be drawn, or none at all (a lone root).
        if end.length() < 1e-3 { Vec3::Y * SHORTEST_END } else { end }
    }

    fn motion(&mut self, motion: &GeneratedMotion) -> fmt::Result {
        let animation = &motion.animation;
        let frame_time = 1.0 / f64::from(animation.fps);
        let frames = animation.root.len();
        writeln!(self.text, "MOTION\nFrames: {frames}\nFrame Time: {frame_time:.8}")?;
        let mut angles = vec![[0.0; 3]; self.skeleton.joints.len()];
        for (&root, rotations) in animation.root.iter().zip(&animation.rotations) {
            let start = self.text.len();
            self.lengths(root)?;
            for index in 0..self.order.len() {
                let joint = self.order[index];
                angles[joint] = nearest_angles(rotations[joint].as_dquat(), angles[joint]);
                for angle in angles[joint] {
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

    fn lengths(&mut self, metres: Vec3) -> fmt::Result {
        let decimals = self.unit.decimals();
        for value in (metres * self.unit.per_metre()).to_array() {
            self.text.push(' ');
            push_decimal(&mut self.text, value.into(), decimals)?;
        }
        Ok(())
    }
}

/// Turns a name into one that BVH can hold: one word without braces.
fn token(name: &str) -> String {
    let fits = |c: char| !c.is_whitespace() && !c.is_control() && !matches!(c, '{' | '}');
    name.chars().map(|c| if fits(c) { c } else { '_' }).collect()
}
