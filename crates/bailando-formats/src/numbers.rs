//! Large arrays of numbers, written without an intermediate copy as JSON values.

use std::str::FromStr;

use base64::{display::Base64Display, engine::general_purpose::STANDARD};
use glam::{Quat, Vec3};
use ndarray::{ArrayView2, ArrayView3};
use serde::{Deserialize, Serialize, Serializer};

use crate::error::FormatError;

/// The way in which large arrays of numbers are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// Nested JSON arrays, numbers rounded to 6 decimals (a micrometre: smooth enough for speeds
    /// and accelerations to be taken from them).
    #[default]
    Json,
    /// A base64 string of little-endian float32 in the same order, nothing rounded.
    Base64,
}

impl FromStr for Encoding {
    type Err = FormatError;

    fn from_str(name: &str) -> Result<Self, FormatError> {
        match name {
            "json" => Ok(Self::Json),
            "base64" => Ok(Self::Base64),
            _ => Err(FormatError::Choice {
                name: "encoding",
                got: name.into(),
                accepted: "json or base64",
            }),
        }
    }
}

/// One array of a motion.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Block<'a> {
    /// `[frames, joints, 3]`.
    Positions(ArrayView3<'a, f32>),
    /// `[frames][joints]`, written as x y z w.
    Rotations(&'a [Vec<Quat>]),
    /// `[frames]`.
    Root(&'a [Vec3]),
}

/// An array and its encoding.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers<'a> {
    pub(crate) block: Block<'a>,
    pub(crate) encoding: Encoding,
}

/// Numbers of every frame and joint: nested arrays `[frames][joints][3 or 4]`, or with
/// `encoding=base64` one string of little-endian float32 in the same order.
#[cfg(feature = "openapi")]
#[derive(Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes the schema of `Numbers`")]
pub(crate) enum PoseNumbers {
    Nested(Vec<Vec<Vec<f32>>>),
    Packed(String),
}

/// Numbers of every frame: nested arrays `[frames][3]`, or with `encoding=base64` one string of
/// little-endian float32 in the same order.
#[cfg(feature = "openapi")]
#[derive(Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes the schema of `Numbers`")]
pub(crate) enum RootNumbers {
    Nested(Vec<Vec<f32>>),
    Packed(String),
}

impl Serialize for Numbers<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.encoding == Encoding::Base64 {
            let bytes = self.block.little_endian();
            return serializer.collect_str(&Base64Display::new(&bytes, &STANDARD));
        }
        match self.block {
            Block::Positions(frames) => {
                serializer.collect_seq(frames.outer_iter().map(PositionRows))
            }
            Block::Rotations(frames) => {
                serializer.collect_seq(frames.iter().map(|pose| RotationRows(pose)))
            }
            Block::Root(root) => {
                serializer.collect_seq(root.iter().map(|p| p.to_array().map(rounded)))
            }
        }
    }
}

impl Block<'_> {
    fn little_endian(&self) -> Vec<u8> {
        match self {
            Self::Positions(positions) => pack(positions.iter().copied()),
            Self::Rotations(frames) => pack(frames.iter().flatten().flat_map(|q| q.to_array())),
            Self::Root(root) => pack(root.iter().flat_map(|p| p.to_array())),
        }
    }
}

fn pack(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(f32::to_le_bytes).collect()
}

struct PositionRows<'a>(ArrayView2<'a, f32>);

impl Serialize for PositionRows<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let joints = self.0.outer_iter();
        serializer.collect_seq(joints.map(|joint| [0, 1, 2].map(|axis| rounded(joint[axis]))))
    }
}

struct RotationRows<'a>(&'a [Quat]);

impl Serialize for RotationRows<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|q| q.to_array().map(rounded)))
    }
}

/// Rounds to 6 decimals, as a double so that its shortest text has no more; never `-0.0`.
fn rounded(value: f32) -> f64 {
    (f64::from(value) * 1e6).round() / 1e6 + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_to_a_micrometre() {
        for (value, text) in [
            (0.123_456_79_f32, "0.123457"),
            (-1.5, "-1.5"),
            (-1e-9, "0.0"),
            (0.1, "0.1"),
            (12.345_678, "12.345678"),
        ] {
            assert_eq!(serde_json::to_string(&rounded(value)).unwrap(), text);
        }
    }
}
