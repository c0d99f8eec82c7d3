//! The formats and their names.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{
    bvh::{BvhUnit, bvh_bytes, to_bvh},
    error::FormatError,
    json::{JsonOptions, json_bytes, to_json},
    motion::GeneratedMotion,
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
    /// ([`to_bvh`]).
    Bvh,
}

impl OutputFormat {
    /// Every format.
    pub const ALL: [Self; 2] = [Self::Json, Self::Bvh];

    /// Returns its name in options, which is also the extension of its files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Bvh => "bvh",
        }
    }

    /// Returns its media type. BVH has no registered one; `application/x-bvh` is the customary
    /// name.
    #[must_use]
    pub fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Bvh => "application/x-bvh",
        }
    }

    /// Returns about the most bytes that a motion takes in this format: what [`Self::write`]
    /// reserves, and a little more.
    #[must_use]
    pub fn most_bytes(self, motion: &GeneratedMotion, json: &JsonOptions) -> usize {
        let most = match self {
            Self::Json => json_bytes(motion, json),
            Self::Bvh => bvh_bytes(motion),
        };
        most.saturating_add(most / 16)
    }

    /// Writes a motion in this format.
    ///
    /// # Errors
    /// As [`to_json`] and [`to_bvh`].
    pub fn write(
        self,
        motion: &GeneratedMotion,
        json: &JsonOptions,
        unit: BvhUnit,
    ) -> Result<Vec<u8>, FormatError> {
        match self {
            Self::Json => to_json(motion, json),
            Self::Bvh => to_bvh(motion, unit).map(String::into_bytes),
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
            accepted: "json or bvh",
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
        let error = "fbx".parse::<OutputFormat>().unwrap_err().to_string();
        assert!(error.ends_with("choose json or bvh"), "{error}");
    }
}
