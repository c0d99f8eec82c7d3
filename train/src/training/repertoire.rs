//! What recordings of a style begin with, and which codes they have.

use std::collections::{BTreeMap, BTreeSet};

use bailando::model::StyleCodes;

use super::{codes::Codes, piece::MotionPiece};

/// A code belongs to a style if its share of the style's codes is at least this part of its share
/// of all codes: rarer ones lead into the styles that they are of.
const LEAST_SHARE: f64 = 0.1;

/// How often each code of both halves is used.
type Uses = [BTreeMap<u32, f64>; 2];

/// Training motions and their codes.
pub(super) struct Repertoire<'a> {
    pub(super) codes: &'a Codes,
    pub(super) pieces: &'a [MotionPiece],
}

impl Repertoire<'_> {
    /// Returns the pairs of codes that motions of each style begin with, each once; `firsts` has
    /// the first frame of each motion that is learned.
    pub(super) fn starts(
        &self,
        styles: &[String],
        firsts: &[usize],
    ) -> BTreeMap<String, Vec<[u32; 2]>> {
        let mut found: BTreeMap<String, BTreeSet<[u32; 2]>> = BTreeMap::new();
        for (motion, pair) in self.codes.starts(firsts) {
            if let Some(name) = self.style(styles, motion) {
                found.entry(name.clone()).or_default().insert(pair);
            }
        }
        found.into_iter().map(|(name, pairs)| (name, pairs.into_iter().collect())).collect()
    }

    /// Returns the codes of each style.
    pub(super) fn style_codes(&self, styles: &[String]) -> BTreeMap<String, StyleCodes> {
        let mut uses: BTreeMap<String, Uses> = BTreeMap::new();
        for motion in 0..self.pieces.len() {
            let Some(name) = self.style(styles, motion) else { continue };
            let own = uses.entry(name.clone()).or_default();
            for pair in self.codes.whole(motion) {
                for (own, codes) in own.iter_mut().zip(pair) {
                    for &code in codes {
                        *own.entry(code as u32).or_default() += 1.0;
                    }
                }
            }
        }
        of_styles(&uses)
    }

    fn style<'a>(&self, styles: &'a [String], motion: usize) -> Option<&'a String> {
        styles.get(self.pieces.get(motion)?.facts().style?)
    }
}

fn of_styles(uses: &BTreeMap<String, Uses>) -> BTreeMap<String, StyleCodes> {
    let all = [0, 1].map(|half| {
        let mut all: BTreeMap<u32, f64> = BTreeMap::new();
        for (code, count) in uses.values().flat_map(|uses| &uses[half]) {
            *all.entry(*code).or_default() += count;
        }
        all
    });
    let total = |uses: &BTreeMap<u32, f64>| uses.values().sum::<f64>();
    let own = |half: usize, uses: &BTreeMap<u32, f64>| {
        let least = LEAST_SHARE * total(uses) / total(&all[half]);
        let typical = uses.iter().filter(|(code, count)| **count >= least * all[half][*code]);
        typical.map(|(code, _)| *code).collect()
    };
    let codes = |[upper, lower]: &Uses| StyleCodes { upper: own(0, upper), lower: own(1, lower) };
    uses.iter().map(|(style, uses)| (style.clone(), codes(uses))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_that_is_rare_in_a_style_for_its_use_is_anothers() {
        let of = |counts: &[(u32, f64)]| counts.iter().copied().collect::<BTreeMap<_, _>>();
        // 100 codes each: code 2 makes 1 % of house and 31 % of all, code 7 as little of both.
        let house = of(&[(1, 98.0), (2, 1.0), (7, 1.0)]);
        let lock = of(&[(2, 61.0), (3, 39.0)]);
        let uses = [("house", house), ("lock", lock)];
        let uses = uses.map(|(style, uses)| (style.to_owned(), [uses, of(&[(4, 100.0)])]));
        let found = of_styles(&uses.into());
        assert_eq!(found["house"], StyleCodes { upper: vec![1, 7], lower: vec![4] });
        assert_eq!(found["lock"], StyleCodes { upper: vec![2, 3], lower: vec![4] });
    }
}
