//! What a model's training did with each code: how often it was used, what followed it, and what
//! the other half of the body did beside it.

use std::{cmp::Reverse, collections::BTreeMap, fs, io::ErrorKind};

use serde::{Deserialize, Serialize};

use crate::{error::CodebookError, half::Half, uses::Uses};
use bailando_model::ModelDirectory;

/// File of a model directory.
pub const MEMORY_FILE: &str = "memory.json";
/// Followers, and codes of the other half, that are kept of each code: the most frequent. Whole
/// motions can't be put together from them.
const KEPT: usize = 8;

/// Counts of a model's codes over its training motions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Memory {
    /// SHA-256 of the manifest of the model whose codes these are.
    pub manifest_sha256: String,
    /// Number of motions.
    pub motions: u64,
    /// Codes of the upper half of the body, by number.
    pub upper: Vec<CodeUses>,
    /// Codes of the lower half.
    pub lower: Vec<CodeUses>,
}

/// Counts of one code.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CodeUses {
    /// How often it was used.
    pub uses: u64,
    /// Other codes of its half that came next, with how often they did, the most frequent first.
    pub next: Vec<[u64; 2]>,
    /// Codes of the other half at the same time, likewise.
    pub beside: Vec<[u64; 2]>,
}

impl Memory {
    /// Summarises what was counted of the codes of the model with this manifest.
    #[must_use]
    pub fn new(uses: &Uses, manifest_sha256: &str) -> Self {
        let half = |half: Half| {
            let codes = uses.of(half).iter().zip(0..);
            let code = |(&uses_of_code, code): (&u64, u32)| CodeUses {
                uses: uses_of_code,
                next: most_frequent(uses.next(half, code)),
                beside: most_frequent(uses.beside(half, code)),
            };
            codes.map(code).collect()
        };
        Self {
            manifest_sha256: manifest_sha256.to_owned(),
            motions: uses.motions(),
            upper: half(Half::Upper),
            lower: half(Half::Lower),
        }
    }

    /// Reads the memory of a model directory; `None` where it has none.
    ///
    /// # Errors
    /// [`CodebookError::Memory`] for a file that can't be read, or that is another model's.
    pub fn read(directory: &ModelDirectory) -> Result<Option<Self>, CodebookError> {
        let path = directory.root().join(MEMORY_FILE);
        let refuse = |problem: String| CodebookError::Memory { path: path.clone(), problem };
        let text = match fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            text => text.map_err(|error| refuse(error.to_string()))?,
        };
        let memory: Self =
            serde_json::from_slice(&text).map_err(|error| refuse(error.to_string()))?;
        let vocabulary = directory.manifest().vocabulary;
        let counted = [memory.upper.len(), memory.lower.len()];
        let fits = memory.manifest_sha256 == directory.manifest_sha256()
            && counted == [vocabulary.upper, vocabulary.lower];
        match fits {
            true => Ok(Some(memory)),
            false => Err(refuse("it counts the codes of another model".to_owned())),
        }
    }
}

fn most_frequent(counts: BTreeMap<u32, u64>) -> Vec<[u64; 2]> {
    let mut counts: Vec<_> = counts.into_iter().map(|(code, uses)| [code.into(), uses]).collect();
    // Stable: equally frequent ones stay in the order of their codes.
    counts.sort_by_key(|&[_, uses]| Reverse(uses));
    counts.truncate(KEPT);
    counts
}

#[cfg(test)]
mod tests {
    use bailando_formats::Codes;
    use bailando_model::Vocabulary;

    use super::*;

    #[test]
    fn followers_and_companions_are_counted_half_by_half() {
        let mut uses = Uses::new(Vocabulary { upper: 4, lower: 3 });
        let codes = Codes { upper: vec![3, 3, 0, 3, 0], lower: vec![1, 1, 1, 2, 2] };
        uses.add(&codes).unwrap();
        uses.add(&Codes { upper: vec![3, 1], lower: vec![0, 0] }).unwrap();
        let memory = Memory::new(&uses, "abc");
        assert_eq!((memory.motions, memory.upper.len(), memory.lower.len()), (2, 4, 3));
        let code = |uses, next: &[[u64; 2]], beside: &[[u64; 2]]| CodeUses {
            uses,
            next: next.to_vec(),
            beside: beside.to_vec(),
        };
        // A held code does not follow itself.
        assert_eq!(memory.upper[3], code(4, &[[0, 2], [1, 1]], &[[1, 2], [0, 1], [2, 1]]));
        assert_eq!(memory.upper[2], CodeUses::default());
        assert_eq!(memory.lower[1], code(3, &[[2, 1]], &[[3, 2], [0, 1]]));
    }
}
