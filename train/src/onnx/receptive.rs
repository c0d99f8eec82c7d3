//! The receptive field of a decoded code: the overlap at which chunks decode like the whole.

use crate::weights::{DecoderWeights, VqVaeWeights};

/// Codes on either side of a code that can influence its frames, over all three decoders.
///
/// All padding is zeros, so a chunk's end differs from the same place inside a longer piece; frames
/// whose receptive field lies inside the chunk do not.
#[must_use]
pub fn receptive_codes(weights: &VqVaeWeights) -> usize {
    [&weights.upper.decoder, &weights.lower.decoder, &weights.root]
        .into_iter()
        .map(decoder_reach)
        .max()
        .unwrap_or(0)
}

/// Follows the frames of code 0 back through the layers, as an interval of input positions.
fn decoder_reach(decoder: &DecoderWeights) -> usize {
    let frames = 1_i64 << decoder.levels.len();
    let mut reach = Interval { first: 0, last: frames - 1 };
    reach.widen(1);
    for level in decoder.levels.iter().rev() {
        reach.through_doubling();
        for block in &level.stack {
            reach.widen(i64::try_from(block.dilation).unwrap_or(i64::MAX));
        }
    }
    reach.widen(1);
    let side = reach.last.max(reach.first.saturating_neg());
    usize::try_from(side).unwrap_or(0)
}

struct Interval {
    first: i64,
    last: i64,
}

impl Interval {
    /// A kernel of 3 with this dilation, padded to keep the length.
    fn widen(&mut self, dilation: i64) {
        self.first = self.first.saturating_sub(dilation);
        self.last = self.last.saturating_add(dilation);
    }

    /// A transposed convolution of kernel 4, stride 2, padding 1: input `i` reaches the outputs `2i
    /// - 1 ..= 2i + 2`, so output `o` needs the inputs `ceil((o - 2) / 2) ..= floor((o + 1) / 2)`.
    fn through_doubling(&mut self) {
        self.first = self.first.saturating_sub(1).div_euclid(2);
        self.last = self.last.saturating_add(1).div_euclid(2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubling_reaches_the_inputs_that_its_definition_names() {
        for output in -9_i64..9 {
            let inputs = (-20..20).filter(|i| (2 * i - 1..=2 * i + 2).contains(&output));
            let inputs: Vec<i64> = inputs.collect();
            let mut reach = Interval { first: output, last: output };
            reach.through_doubling();
            assert_eq!((reach.first, reach.last), (inputs[0], inputs[inputs.len() - 1]));
        }
    }
}
