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

    /// The format with this media type, parameters (`; charset=utf-8`) and case aside.
    ///
    /// # Errors
    /// [`FormatError::Unknown`] for any other media type.
    pub fn from_content_type(media_type: &str) -> Result<Self, FormatError> {
        let essence = media_type.split(';').next().unwrap_or_default().trim();
        Self::find(essence, Self::content_type)
    }

    /// The format of files with this extension, without the dot and in any case.
    ///
    /// # Errors
    /// [`FormatError::Unknown`] for any other extension.
    pub fn from_extension(extension: &str) -> Result<Self, FormatError> {
        Self::find(extension, Self::name)
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

    fn find(wanted: &str, key: fn(Self) -> &'static str) -> Result<Self, FormatError> {
        Self::ALL
            .into_iter()
            .find(|&format| key(format).eq_ignore_ascii_case(wanted))
            .ok_or_else(|| FormatError::Unknown { got: wanted.into() })
    }
}

impl FromStr for OutputFormat {
    type Err = FormatError;

    fn from_str(name: &str) -> Result<Self, FormatError> {
        Self::find(name, Self::name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_leads_back_to_its_format() {
        for format in OutputFormat::ALL {
            assert_eq!(format.name().parse::<OutputFormat>().unwrap(), format);
            assert_eq!(OutputFormat::from_extension(format.name()).unwrap(), format);
            let parameters = format!("{} ; charset=utf-8", format.content_type().to_uppercase());
            assert_eq!(
                OutputFormat::from_content_type(&parameters).unwrap(),
                format
            );
        }
    }

    #[test]
    fn other_names_are_refused_with_what_there_is() {
        for error in [
            "fbx".parse::<OutputFormat>().unwrap_err(),
            OutputFormat::from_content_type("video/mp4").unwrap_err(),
            OutputFormat::from_extension("").unwrap_err(),
        ] {
            assert!(error.to_string().ends_with("choose json or bvh"), "{error}");
        }
    }
}
