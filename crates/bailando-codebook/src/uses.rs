//! How often dances use each code, and each change from one pair of codes to another.

use std::{cmp::Reverse, collections::BTreeMap};

use super::{CodebookError, Half};
use bailando_formats::Codes;
use bailando_model::Vocabulary;

/// An upper and a lower code: a whole body.
pub(super) type Pair = [u32; 2];

/// Counts over any number of dances.
#[derive(Clone, Debug)]
pub struct Uses {
    upper: Vec<u64>,
    lower: Vec<u64>,
    changes: BTreeMap<[Pair; 2], u64>,
}

impl Uses {
    /// No dance yet.
    #[must_use]
    pub fn new(vocabulary: Vocabulary) -> Self {
        Self {
            upper: vec![0; vocabulary.upper],
            lower: vec![0; vocabulary.lower],
            changes: BTreeMap::new(),
        }
    }

    /// Counts one dance.
    ///
    /// # Errors
    /// [`CodebookError::Codes`] where a code is not in the vocabulary or has no partner; nothing of
    /// the dance is counted then.
    pub fn add(&mut self, dance: &Codes) -> Result<(), CodebookError> {
        let Codes { upper, lower } = dance;
        if upper.len() != lower.len() {
            let (upper, lower) = (upper.len(), lower.len());
            let problem = format!("{upper} upper and {lower} lower codes: expected pairs");
            return Err(CodebookError::Codes(problem));
        }
        for (half, codes) in [(Half::Upper, upper), (Half::Lower, lower)] {
            let size = self.of(half).len();
            if let Some(code) = codes.iter().find(|&&code| code as usize >= size) {
                let name = half.name();
                let problem = format!("{name} code {code}, but the model has {size}: is it its?");
                return Err(CodebookError::Codes(problem));
            }
        }
        for (counts, codes) in [(&mut self.upper, upper), (&mut self.lower, lower)] {
            for &code in codes {
                if let Some(count) = counts.get_mut(code as usize) {
                    *count += 1;
                }
            }
        }
        let pairs: Vec<Pair> = upper.iter().zip(lower).map(|(&u, &l)| [u, l]).collect();
        for (&from, &to) in pairs.iter().zip(pairs.iter().skip(1)) {
            if from != to {
                *self.changes.entry([from, to]).or_insert(0) += 1;
            }
        }
        Ok(())
    }

    /// Uses of each code.
    #[must_use]
    pub fn of(&self, half: Half) -> &[u64] {
        match half {
            Half::Upper => &self.upper,
            Half::Lower => &self.lower,
        }
    }

    /// The most frequent changes with their counts, the most frequent first.
    pub(super) fn changes(&self, most: usize) -> Vec<([Pair; 2], u64)> {
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
        Codes {
            upper: upper.to_vec(),
            lower: lower.to_vec(),
        }
    }

    #[test]
    fn codes_and_changes_are_counted_over_dances() {
        let mut uses = uses();
        uses.add(&codes(&[3, 3, 0, 3, 0], &[1, 1, 2, 1, 2]))
            .unwrap();
        uses.add(&codes(&[1, 0], &[1, 2])).unwrap();
        assert_eq!(uses.of(Half::Upper), [3, 1, 0, 3]);
        assert_eq!(uses.of(Half::Lower), [0, 4, 3]);
        // A pose that is held is no change; the end of one dance does not lead to the next.
        let expected = [
            ([[3, 1], [0, 2]], 2),
            ([[0, 2], [3, 1]], 1),
            ([[1, 1], [0, 2]], 1),
        ];
        assert_eq!(uses.changes(9), expected);
        assert_eq!(uses.changes(1), expected[..1]);
    }

    #[test]
    fn dances_of_another_model_are_refused_whole() {
        let mut uses = uses();
        assert!(uses.add(&codes(&[0, 4], &[0, 0])).is_err());
        assert!(uses.add(&codes(&[0, 1], &[0, 3])).is_err());
        assert!(uses.add(&codes(&[0, 1], &[0])).is_err());
        assert_eq!(uses.of(Half::Upper), [0; 4]);
    }
}
