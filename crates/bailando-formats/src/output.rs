//! The formats and their names.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{
    bvh::{BvhUnit, bvh_bytes, to_bvh_for},
    error::FormatError,
    fbx::{fbx_bytes, to_fbx},
    glb::{GlbOptions, glb_bytes, to_glb},
    json::{JsonOptions, json_bytes, to_json},
    motion::{GeneratedMotion, MotionSize},
    npz::{npz_bytes, to_npz},
    target::TargetSkeleton,
    vmd::{to_vmd, vmd_bytes},
    vrma::{to_vrma, vrma_bytes},
};

/// A file format for motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum OutputFormat {
    /// Positions, codes, music and timings ([`to_json`]).
    #[default]
    Json,
    /// Biovision hierarchy: skeleton and rotations, for Blender and other animation programs
    /// ([`to_bvh_for`]).
    Bvh,
    /// Binary glTF 2.0: bones, animation and a doll, for browsers and game engines ([`to_glb`]).
    Glb,
    /// VRM animation 1.0, for avatars ([`to_vrma`]).
    Vrma,
    /// FBX, binary 7.4, for Unreal, Unity and Maya ([`to_fbx`]).
    Fbx,
    /// MikuMikuDance ([`to_vmd`]).
    Vmd,
    /// NumPy archive in the layout of AMASS ([`to_npz`]).
    Npz,
}

/// How a motion is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteOptions {
    /// Contents of JSON.
    pub json: JsonOptions,
    /// Unit of BVH.
    pub bvh_unit: BvhUnit,
    /// Skeleton of BVH, GLB and FBX; the other formats have their own.
    pub skeleton: TargetSkeleton,
    /// Whether GLB carries a doll.
    pub mannequin: bool,
}

impl Default for WriteOptions {
    fn default() -> Self {
        let (json, bvh_unit) = (JsonOptions::default(), BvhUnit::default());
        Self { json, bvh_unit, skeleton: TargetSkeleton::default(), mannequin: true }
    }
}

impl OutputFormat {
    /// Every format, the default first.
    pub const ALL: [Self; 7] =
        [Self::Json, Self::Bvh, Self::Glb, Self::Vrma, Self::Fbx, Self::Vmd, Self::Npz];

    /// Returns its name in options, which is also the extension of its files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Bvh => "bvh",
            Self::Glb => "glb",
            Self::Vrma => "vrma",
            Self::Fbx => "fbx",
            Self::Vmd => "vmd",
            Self::Npz => "npz",
        }
    }

    /// Returns its media type. Only JSON and GLB have a registered one, and VRM animation is GLB;
    /// the others have the customary or a similar name.
    #[must_use]
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Bvh => "application/x-bvh",
            Self::Glb | Self::Vrma => "model/gltf-binary",
            Self::Fbx => "application/x-fbx",
            Self::Vmd => "application/x-vmd",
            Self::Npz => "application/x-npz",
        }
    }

    /// Returns about the most bytes that a motion of this size takes in this format: what
    /// [`Self::write`] reserves, and a little more.
    #[must_use]
    pub fn most_bytes(self, size: MotionSize, options: &WriteOptions) -> usize {
        let most = match self {
            Self::Json => json_bytes(size, &options.json),
            Self::Bvh => bvh_bytes(size),
            // A binary file is put together of two parts that exist beside it.
            Self::Glb => 2 * glb_bytes(size),
            Self::Vrma => 2 * vrma_bytes(size),
            Self::Fbx => fbx_bytes(size),
            Self::Vmd => vmd_bytes(size),
            Self::Npz => npz_bytes(size),
        };
        most.saturating_add(most / 16)
    }

    /// Writes a motion in this format.
    ///
    /// # Errors
    /// As [`to_json`], [`to_bvh_for`], [`to_glb`], [`to_vrma`], [`to_fbx`], [`to_vmd`] and
    /// [`to_npz`].
    pub fn write(
        self,
        motion: &GeneratedMotion,
        options: &WriteOptions,
    ) -> Result<Vec<u8>, FormatError> {
        let WriteOptions { json, bvh_unit, skeleton, mannequin } = *options;
        match self {
            Self::Json => to_json(motion, &json),
            Self::Bvh => to_bvh_for(motion, bvh_unit, skeleton).map(String::into_bytes),
            Self::Glb => to_glb(motion, GlbOptions { skeleton, mannequin }),
            Self::Vrma => to_vrma(motion),
            Self::Fbx => to_fbx(motion, skeleton),
            Self::Vmd => to_vmd(motion),
            Self::Npz => to_npz(motion),
        }
    }
}

impl FromStr for OutputFormat {
    type Err = FormatError;

    fn from_str(name: &str) -> Result<Self, FormatError> {
        let mut all = Self::ALL.into_iter();
        let found = all.find(|format| format.name().eq_ignore_ascii_case(name));
        found.ok_or_else(|| FormatError::Choice {
            name: "format",
            got: name.into(),
            accepted: "json, bvh, glb, vrma, fbx, vmd or npz",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_to_their_formats_and_others_are_refused() {
        for format in OutputFormat::ALL {
            assert_eq!(format.name().parse::<OutputFormat>().unwrap(), format);
        }
        let error = "mp4".parse::<OutputFormat>().unwrap_err().to_string();
        assert!(error.ends_with("choose json, bvh, glb, vrma, fbx, vmd or npz"), "{error}");
    }
}
