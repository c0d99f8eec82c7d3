//! How often motions use each code, and each change from one pair of codes to another.

use std::{cmp::Reverse, collections::BTreeMap};

use crate::{error::CodebookError, half::Half};
use bailando_formats::Codes;
use bailando_model::Vocabulary;

/// An upper and a lower code: a whole body.
pub(crate) type Pair = [u32; 2];

/// Counts of codes and of changes over any number of motions.
#[derive(Clone, Debug)]
pub struct Uses {
    /// Upper, then lower.
    counts: [Vec<u64>; 2],
    changes: BTreeMap<[Pair; 2], u64>,
    pairs: BTreeMap<Pair, u64>,
    motions: u64,
}

impl Uses {
    /// Starts at 0 for every code.
    #[must_use]
    pub fn new(vocabulary: Vocabulary) -> Self {
        Self {
            counts: [vocabulary.upper, vocabulary.lower].map(|codes| vec![0; codes]),
            changes: BTreeMap::new(),
            pairs: BTreeMap::new(),
            motions: 0,
        }
    }

    /// Counts the codes of one motion.
    ///
    /// # Errors
    /// [`CodebookError::Codes`] where a code is not in the vocabulary or has no partner; nothing of
    /// the motion is counted then.
    pub fn add(&mut self, codes: &Codes) -> Result<(), CodebookError> {
        let Codes { upper, lower } = codes;
        if upper.len() != lower.len() {
            let (upper, lower) = (upper.len(), lower.len());
            let problem = format!("{upper} upper and {lower} lower codes: expected pairs");
            return Err(CodebookError::Codes(problem));
        }
        for (half, codes) in Half::BOTH.into_iter().zip([upper, lower]) {
            let size = self.of(half).len();
            if let Some(code) = codes.iter().find(|&&code| code as usize >= size) {
                return Err(CodebookError::Codes(format!(
                    "{} code {code}, but the model has {size}: are they of this model?",
                    half.name()
                )));
            }
        }
        for (counts, codes) in self.counts.iter_mut().zip([upper, lower]) {
            for &code in codes {
                counts[code as usize] += 1;
            }
        }
        self.motions += 1;
        let pairs: Vec<Pair> = upper.iter().zip(lower).map(|(&u, &l)| [u, l]).collect();
        for &pair in &pairs {
            *self.pairs.entry(pair).or_insert(0) += 1;
        }
        for (&from, &to) in pairs.iter().zip(pairs.iter().skip(1)) {
            if from != to {
                *self.changes.entry([from, to]).or_insert(0) += 1;
            }
        }
        Ok(())
    }

    /// Uses of each code of a half.
    #[must_use]
    pub fn of(&self, half: Half) -> &[u64] {
        half.of::<Vec<u64>>(&self.counts)
    }

    /// Number of motions.
    #[must_use]
    pub fn motions(&self) -> u64 {
        self.motions
    }

    /// Other codes of a half that came after `code`.
    pub(crate) fn next(&self, half: Half, code: u32) -> BTreeMap<u32, u64> {
        let mut next = BTreeMap::new();
        for ([from, to], uses) in &self.changes {
            let (from, to) = (*half.of(from), *half.of(to));
            if from == code && to != code {
                *next.entry(to).or_insert(0) += uses;
            }
        }
        next
    }

    /// Codes of the other half at the same time as `code`.
    pub(crate) fn beside(&self, half: Half, code: u32) -> BTreeMap<u32, u64> {
        let with = self.pairs.iter().filter(|(pair, _)| *half.of(pair) == code);
        with.map(|(pair, &uses)| (*half.other().of(pair), uses)).collect()
    }

    /// The most frequent changes with their counts, in descending order.
    pub(crate) fn changes(&self, most: usize) -> Vec<([Pair; 2], u64)> {
        let mut changes: Vec<_> = self.changes.iter().map(|(&c, &uses)| (c, uses)).collect();
        // Stable: equally frequent ones stay in the order of their codes.
        changes.sort_by_key(|&(_, uses)| Reverse(uses));
        changes.truncate(most);
        changes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uses() -> Uses {
        Uses::new(Vocabulary { upper: 4, lower: 3 })
    }

    fn codes(upper: &[u32], lower: &[u32]) -> Codes {
        Codes { upper: upper.to_vec(), lower: lower.to_vec() }
    }

    #[test]
    fn codes_and_changes_are_counted_over_motions() {
        let mut uses = uses();
        uses.add(&codes(&[3, 3, 0, 3, 0], &[1, 1, 2, 1, 2])).unwrap();
        uses.add(&codes(&[1, 0], &[1, 2])).unwrap();
        assert_eq!(uses.of(Half::Upper), [3, 1, 0, 3]);
        assert_eq!(uses.of(Half::Lower), [0, 4, 3]);
        // A held pose is no change, nor is the end of one motion and the start of the next.
        let expected = [([[3, 1], [0, 2]], 2), ([[0, 2], [3, 1]], 1), ([[1, 1], [0, 2]], 1)];
        assert_eq!(uses.changes(9), expected);
        assert_eq!(uses.changes(1), expected[..1]);
    }

    #[test]
    fn motions_of_another_model_are_refused_whole() {
        let mut uses = uses();
        for (upper, lower) in [([0, 4], &[0, 0][..]), ([0, 1], &[0, 3]), ([0, 1], &[0])] {
            assert!(uses.add(&codes(&upper, lower)).is_err());
        }
        assert_eq!(uses.of(Half::Upper), [0; 4]);
    }
}
