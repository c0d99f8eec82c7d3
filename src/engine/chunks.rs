//! Which codes are decoded together: chunks that overlap, so that motion is the same as at once,
//! with bounded memory and while later codes are still unknown.

/// Codes decoded per chunk besides the overlap, which is a sixth of the work then; memory does not
/// grow with the song.
pub(crate) const CHUNK_CODES: usize = 256;
/// Codes of a stream's first chunk, a little more than floor and clean-up look ahead; each further
/// chunk is twice as long.
const FIRST_CHUNK: usize = 32;
/// Codes of the last chunk of a motion that is wanted whole, up to twice as many: all others are
/// decoded while the model still chooses codes, and during the last one it has nothing left to do.
const LAST_CHUNK: usize = 96;

/// The order in which codes are decoded. It depends on the number of codes alone, so that a motion
/// does not depend on what else is computed meanwhile.
///
/// The codes that the decoder sees on either side of a chunk are decoded with it and dropped again;
/// only the motion's own ends see the zero padding (ARCHITECTURE section 2).
#[derive(Debug)]
pub(crate) struct ChunkPlan {
    /// Codes that the decoder sees on either side of one.
    receptive: usize,
    /// Codes before the first: they are decoded with it, so that the motion continues them.
    prompt: Vec<[u32; 2]>,
    /// Codes of the whole motion.
    total: usize,
    /// Codes of the chunks so far.
    planned: usize,
    /// Codes of the next chunk.
    size: usize,
    /// Codes that are left for the last one.
    last: usize,
}

/// Codes to decode, with those around them that the decoder sees.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Chunk {
    pub(crate) codes: Vec<[u32; 2]>,
    /// How many of them come before the chunk.
    pub(crate) before: usize,
    /// How many are the chunk.
    pub(crate) length: usize,
}

impl ChunkPlan {
    /// A plan for `total` codes after those of `prompt`, and a decoder that sees `receptive` codes
    /// on either side of one.
    pub(crate) fn new(total: usize, prompt: Vec<[u32; 2]>, receptive: usize) -> Self {
        Self { receptive, prompt, total, planned: 0, size: CHUNK_CODES, last: LAST_CHUNK }
    }

    /// With small chunks first, so that the first frames come soon.
    pub(crate) fn soon(self) -> Self {
        self.starting_with(FIRST_CHUNK)
    }

    /// With a first chunk of `size` codes.
    pub(crate) fn starting_with(self, size: usize) -> Self {
        Self { size, last: 0, ..self }
    }

    /// Whether all chunks are planned.
    pub(crate) fn is_complete(&self) -> bool {
        self.planned >= self.total
    }

    /// The next chunk, once `codes` reach as far as the decoder sees from it.
    pub(crate) fn next(&mut self, codes: &[[u32; 2]]) -> Option<Chunk> {
        let receptive = self.receptive;
        let length = self.next_length();
        let end = (self.planned + length + receptive).min(self.total);
        if self.is_complete() || codes.len() < end {
            return None;
        }
        // From here on counted from the first code of the prompt.
        let from = self.prompt.len() + self.planned;
        let first = from.saturating_sub(receptive);
        let all = self.prompt.iter().chain(&codes[..end]);
        let codes = all.skip(first).copied().collect();
        self.planned += length;
        self.size = (2 * self.size).min(CHUNK_CODES);
        Some(Chunk { codes, before: from - first, length })
    }

    fn next_length(&self) -> usize {
        let left = self.total.saturating_sub(self.planned);
        // Twice as many as a last one has are not worth the overlap.
        match left < 2 * self.last {
            true => left,
            false => self.size.min(left - self.last),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECEPTIVE: usize = 25;

    fn plan(total: usize) -> ChunkPlan {
        ChunkPlan::new(total, Vec::new(), RECEPTIVE)
    }

    /// Lengths of the chunks once all codes are known.
    fn lengths(mut plan: ChunkPlan) -> Vec<usize> {
        let codes = vec![[0; 2]; plan.total];
        std::iter::from_fn(|| plan.next(&codes).map(|chunk| chunk.length)).collect()
    }

    #[test]
    fn the_last_chunk_is_small_and_no_chunk_is_large() {
        assert_eq!(lengths(plan(1)), [1]);
        assert_eq!(lengths(plan(191)), [191]);
        assert_eq!(lengths(plan(192)), [96, 96]);
        assert_eq!(lengths(plan(228)), [132, 96]);
        assert_eq!(lengths(plan(704)), [256, 256, 96, 96]);
        assert_eq!(lengths(plan(700)), [256, 256, 188]);
    }

    #[test]
    fn the_first_chunk_of_a_stream_is_small() {
        assert_eq!(lengths(plan(20).soon()), [20]);
        assert_eq!(lengths(plan(228).soon()), [32, 64, 128, 4]);
    }

    #[test]
    fn a_chunk_waits_for_what_the_decoder_sees_and_brings_it_along() {
        let codes: Vec<[u32; 2]> = (0..228).map(|code| [code, code + 1000]).collect();
        let mut plan = plan(228);
        assert_eq!(plan.next(&codes[..132 + RECEPTIVE - 1]), None);
        let first = plan.next(&codes[..132 + RECEPTIVE]).unwrap();
        assert_eq!((first.before, first.length), (0, 132));
        assert_eq!(first.codes, codes[..132 + RECEPTIVE]);
        assert_eq!(plan.next(&codes[..227]), None);
        let last = plan.next(&codes).unwrap();
        assert_eq!((last.before, last.length), (RECEPTIVE, 96));
        assert_eq!(last.codes, codes[132 - RECEPTIVE..]);
        assert!(plan.is_complete() && plan.next(&codes).is_none());
    }

    #[test]
    fn the_first_chunk_sees_the_prompt() {
        let mut plan = ChunkPlan::new(2, vec![[7, 8]; 40], RECEPTIVE);
        let chunk = plan.next(&[[1, 3], [2, 4]]).unwrap();
        assert_eq!((chunk.before, chunk.length), (RECEPTIVE, 2));
        assert_eq!(chunk.codes[RECEPTIVE - 1..], [[7, 8], [1, 3], [2, 4]]);
    }
}
