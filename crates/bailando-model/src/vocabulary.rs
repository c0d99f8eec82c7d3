//! The pose codes of a model, and those that it never draws.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Number of pose codes per half body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vocabulary {
    /// Codes of the upper half.
    pub upper: usize,
    /// Codes of the lower half.
    pub lower: usize,
}

/// Codes of each half that a dance in a style may draw: those of its training recordings. One that
/// left them would continue in another style.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StyleCodes {
    /// Of the upper half, ascending.
    pub upper: Vec<u32>,
    /// Of the lower half, ascending.
    pub lower: Vec<u32>,
}

impl StyleCodes {
    /// Takes out what is no code of the style.
    pub(super) fn narrow(&self, [upper, lower]: &mut [Vec<u32>; 2]) {
        upper.retain(|code| self.upper.binary_search(code).is_ok());
        lower.retain(|code| self.lower.binary_search(code).is_ok());
    }
}

/// Codes of each half that are never drawn: poses that a dancer cannot hold alone, say. Given
/// codes, and those of a dance that is gone on with, may be among them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SuppressedCodes {
    /// Of the upper half, ascending.
    pub upper: Vec<u32>,
    /// Of the lower half, ascending.
    pub lower: Vec<u32>,
}

impl SuppressedCodes {
    /// Whether every code may be drawn.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.upper.is_empty() && self.lower.is_empty()
    }

    /// Codes that may be drawn, upper and lower, ascending.
    #[must_use]
    pub fn others(&self, vocabulary: Vocabulary) -> [Vec<u32>; 2] {
        let Vocabulary { upper, lower } = vocabulary;
        [(&self.upper, upper), (&self.lower, lower)].map(|(suppressed, size)| {
            // Sizes are at most 65,536: the manifest's check says so.
            let codes = 0..size as u32;
            codes.filter(|code| suppressed.binary_search(code).is_err()).collect()
        })
    }

    pub(super) fn validate(
        &self,
        vocabulary: Vocabulary,
        start_codes: &[[u32; 2]],
    ) -> Result<(), String> {
        let halves =
            [("upper", &self.upper, vocabulary.upper), ("lower", &self.lower, vocabulary.lower)];
        for (half, (name, codes, size)) in halves.into_iter().enumerate() {
            if !codes.is_sorted_by(|a, b| a < b) {
                return Err(format!("suppressed {name} codes are not ascending"));
            }
            if let Some(code) = codes.iter().find(|&&code| code as usize >= size) {
                return Err(format!("suppressed {name} code {code} lies outside the vocabulary"));
            }
            if codes.len() == size {
                return Err(format!("all {name} codes are suppressed"));
            }
            let mut starts = start_codes.iter().filter_map(|pair| pair.get(half));
            if let Some(code) = starts.find(|code| codes.binary_search(code).is_ok()) {
                return Err(format!("start codes hold {name} code {code}, which is suppressed"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: Vocabulary = Vocabulary { upper: 3, lower: 4 };

    fn suppressed(upper: &[u32], lower: &[u32]) -> SuppressedCodes {
        SuppressedCodes { upper: upper.to_vec(), lower: lower.to_vec() }
    }

    #[test]
    fn the_others_may_be_drawn() {
        assert_eq!(suppressed(&[], &[1, 2]).others(SIZES), [vec![0, 1, 2], vec![0, 3]]);
    }

    #[test]
    fn what_leaves_nothing_or_contradicts_itself_is_refused() {
        let check = |codes: SuppressedCodes| codes.validate(SIZES, &[[0, 3]]).err();
        assert_eq!(check(suppressed(&[1, 2], &[0])), None);
        assert_eq!(check(SuppressedCodes::default()), None);
        let says = |codes, part: &str| {
            let found = check(codes).unwrap();
            assert!(found.contains(part), "{found}");
        };
        says(suppressed(&[0, 1, 2], &[]), "all upper codes");
        says(suppressed(&[3], &[]), "outside");
        says(suppressed(&[], &[2, 1]), "not ascending");
        says(suppressed(&[], &[1, 1]), "not ascending");
        says(suppressed(&[], &[3]), "lower code 3");
    }
}
