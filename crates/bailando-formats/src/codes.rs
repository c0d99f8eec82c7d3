//! Pose codes of a motion.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Pose codes of the two half bodies, one pair per 8 frames at 60 fps.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Codes {
    /// Upper half of the body.
    pub upper: Vec<u32>,
    /// Lower half of the body.
    pub lower: Vec<u32>,
}

/// A text that holds no pose codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {}", Codes::WRITTEN)]
pub struct NoCodes;

impl Codes {
    /// How codes are written.
    pub const WRITTEN: &str = "JSON of pose codes: {\"upper\": [..], \"lower\": [..]}, pairs \
                               [[upper, lower], ..], or a dance that has them as `codes`";

    /// The halves of code pairs.
    #[must_use]
    pub fn of_pairs(pairs: &[[u32; 2]]) -> Self {
        let half = |half: usize| pairs.iter().map(|pair| pair[half]).collect();
        Self { upper: half(0), lower: half(1) }
    }
}

/// The ways in which codes are written.
#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Pairs(Vec<[u32; 2]>),
    Halves(Codes),
    Dance { codes: Codes },
}

impl FromStr for Codes {
    type Err = NoCodes;

    /// Reads [`Codes::WRITTEN`].
    fn from_str(text: &str) -> Result<Self, NoCodes> {
        match serde_json::from_str(text).map_err(|_| NoCodes)? {
            Written::Halves(codes) | Written::Dance { codes } => Ok(codes),
            Written::Pairs(pairs) => Ok(Self::of_pairs(&pairs)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_read_as_halves_as_pairs_and_out_of_a_dance() {
        let wanted = Ok(Codes { upper: vec![1, 2], lower: vec![3, 4] });
        for text in [
            r#"{"upper": [1, 2], "lower": [3, 4]}"#,
            "[[1, 3], [2, 4]]",
            r#"{"model": "m", "codes": {"upper": [1, 2], "lower": [3, 4]}, "positions": [[0.5]]}"#,
        ] {
            assert_eq!(text.parse(), wanted, "{text}");
        }
        for text in ["", "1", "[1, 2]", "[[1]]", "[[1, -2]]", r#"{"upper": [1]}"#, "[[0.5, 1]]"] {
            assert_eq!(text.parse::<Codes>(), Err(NoCodes), "{text}");
        }
    }
}
