//! Which formats there are, and how they are called.

use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{BvhUnit, Dance, FormatError, JsonOptions, to_bvh, to_json};

/// A format that a dance can be had in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
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

    /// Its name in options, and the extension of its files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Bvh => "bvh",
        }
    }

    /// Its media type. BVH has no registered one; `application/x-bvh` is the customary name.
    #[must_use]
    pub fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Bvh => "application/x-bvh",
        }
    }

    /// Writes a dance in this format.
    ///
    /// # Errors
    /// As [`to_json`] and [`to_bvh`].
    pub fn write(
        self,
        dance: &Dance,
        json: &JsonOptions,
        unit: BvhUnit,
    ) -> Result<Vec<u8>, FormatError> {
        match self {
            Self::Json => to_json(dance, json),
            Self::Bvh => to_bvh(dance, unit).map(String::into_bytes),
        }
    }
}

impl FromStr for OutputFormat {
    type Err = FormatError;

    fn from_str(name: &str) -> Result<Self, FormatError> {
        Self::ALL
            .into_iter()
            .find(|format| format.name().eq_ignore_ascii_case(name))
            .ok_or_else(|| FormatError::Unknown { got: name.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_leads_back_to_its_format() {
        for format in OutputFormat::ALL {
            assert_eq!(format.name().parse::<OutputFormat>().unwrap(), format);
        }
    }

    #[test]
    fn other_names_are_refused_with_what_there_is() {
        let error = "fbx".parse::<OutputFormat>().unwrap_err();
        assert!(error.to_string().ends_with("choose json or bvh"), "{error}");
    }
}
