//! A dance as the body of an answer.

use super::options::RequestOptions;
use crate::{Result, format::Dance};

/// Formats of a dance, the default first.
pub(crate) const FORMATS: [OutputFormat; 2] = [OutputFormat::Json, OutputFormat::Bvh];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutputFormat {
    Json,
    Bvh,
}

impl OutputFormat {
    pub(crate) fn from_name(name: &str) -> Option<Self> {
        match name {
            "json" => Some(Self::Json),
            "bvh" => Some(Self::Bvh),
            _ => None,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Bvh => "bvh",
        }
    }

    pub(crate) fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Bvh => "application/x-bvh",
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Encoding {
    #[default]
    Numbers,
    Base64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum BvhUnit {
    #[default]
    Centimetres,
    Metres,
}

/// Writes `dance` as `format`.
pub(crate) fn render(dance: &Dance, format: OutputFormat, _: &RequestOptions) -> Result<Vec<u8>> {
    Ok(match format {
        OutputFormat::Json => serde_json::json!({"model": dance.model, "seed": dance.seed, "codes": {"upper": dance.codes.upper, "lower": dance.codes.lower}}).to_string().into_bytes(),
        OutputFormat::Bvh => b"HIERARCHY".to_vec(),
    })
}
