//! Code pairs as the halves that results carry.

use crate::formats::Codes;

/// The upper and lower halves of code pairs.
pub(crate) fn halves(pairs: &[[u32; 2]]) -> Codes {
    let half = |half: usize| pairs.iter().map(|pair| pair[half]).collect();
    Codes { upper: half(0), lower: half(1) }
}
