//! Which codes are decoded together: chunks that overlap, so that motion is the same as at once, with bounded
//! memory and while later codes are still unknown.

use crate::formats::Codes;

/// Codes decoded per chunk besides the overlap, which is a sixth of the work then; memory does not grow
/// with the song.
pub(crate) const CHUNK_CODES: usize = 256;
/// Codes of the first chunk where somebody waits for it, a little more than the floor's lookahead; each further one is
/// twice as long.
const FIRST_CHUNK: usize = 24;
/// Codes that are left for the last chunk where nobody sees frames before, up to twice as many: all others are decoded while the
/// model still chooses codes, and during the last one it has nothing left to do.
const LAST_CHUNK: usize = 96;

/// What of a dance is decoded next, by its length and nothing else: motion does not depend on what else is computed meanwhile.
///
/// The codes that the decoder sees on either side of a chunk are decoded with it and dropped again; only the
/// dance's own ends see the zero padding (ARCHITECTURE section 2).
#[derive(Debug)]
pub(crate) struct ChunkPlan {
    /// Codes that the decoder sees on either side of one.
    receptive: usize,
    /// Codes that come before the dance: they are decoded with it, so that it goes on from them.
    history: Codes,
    /// Codes of the whole dance, and of the chunks so far.
    total: usize,
    planned: usize,
    /// Codes of the next chunk.
    size: usize,
    /// Codes that are left for the last one.
    last: usize,
}

/// Codes to decode, with those around them that the decoder sees.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Chunk {
    pub(crate) codes: Codes,
    /// How many of them come before the chunk.
    pub(crate) before: usize,
    /// How many are the chunk.
    pub(crate) length: usize,
}

impl ChunkPlan {
    /// Nothing yet of a dance of `total` codes behind those of `history`, for a decoder that sees `receptive` codes on either
    /// side of one.
    pub(crate) fn new(total: usize, history: Codes, receptive: usize) -> Self {
        Self {
            receptive,
            history,
            total,
            planned: 0,
            size: CHUNK_CODES,
            last: LAST_CHUNK,
        }
    }

    /// With small chunks first, so that the first frames come soon.
    pub(crate) fn soon(self) -> Self {
        self.starting_with(FIRST_CHUNK)
    }

    /// With a first chunk of `size` codes.
    pub(crate) fn starting_with(self, size: usize) -> Self {
        Self {
            size,
            last: 0,
            ..self
        }
    }

    /// Whether all chunks are planned.
    pub(crate) fn is_complete(&self) -> bool {
        self.planned >= self.total
    }

    /// The next chunk, if `codes` (upper and lower) know it and what follows it as far as it matters.
    pub(crate) fn next(&mut self, codes: [&[u32]; 2]) -> Option<Chunk> {
        let receptive = self.receptive;
        let length = self.next_length();
        let end = (self.planned + length + receptive).min(self.total);
        let known = codes.iter().all(|half| half.len() >= end);
        if self.is_complete() || !known {
            return None;
        }
        // From here on counted from the first code of the history.
        let history = self.history.upper.len();
        let from = history + self.planned;
        let first = from.saturating_sub(receptive);
        let [upper, lower] = codes;
        let part = |history_half: &[u32], half: &[u32]| -> Vec<u32> {
            let all = history_half.iter().chain(half);
            let part = all.take(history + end).skip(first);
            part.copied().collect()
        };
        self.planned += length;
        self.size = (2 * self.size).min(CHUNK_CODES);
        Some(Chunk {
            codes: Codes {
                upper: part(&self.history.upper, upper),
                lower: part(&self.history.lower, lower),
            },
            before: from - first,
            length,
        })
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
        ChunkPlan::new(total, Codes::default(), RECEPTIVE)
    }

    /// Lengths of the chunks once all codes are known.
    fn lengths(mut plan: ChunkPlan) -> Vec<usize> {
        let codes = vec![0; plan.total];
        std::iter::from_fn(|| plan.next([&codes, &codes]).map(|chunk| chunk.length)).collect()
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
    fn where_somebody_waits_the_first_chunk_is_small() {
        assert_eq!(lengths(plan(20).soon()), [20]);
        assert_eq!(lengths(plan(228).soon()), [24, 48, 96, 60]);
    }

    #[test]
    fn a_chunk_waits_for_what_the_decoder_sees_and_brings_it_along() {
        let upper: Vec<u32> = (0..228).collect();
        let lower: Vec<u32> = upper.iter().map(|code| code + 1000).collect();
        let known = |codes: usize| [&upper[..codes], &lower[..codes]];
        let mut plan = plan(228);
        assert_eq!(plan.next(known(132 + RECEPTIVE - 1)), None);
        let first = plan.next(known(132 + RECEPTIVE)).unwrap();
        assert_eq!((first.before, first.length), (0, 132));
        assert_eq!(first.codes.upper, upper[..132 + RECEPTIVE]);
        assert_eq!(plan.next(known(227)), None);
        let last = plan.next(known(228)).unwrap();
        assert_eq!((last.before, last.length), (RECEPTIVE, 96));
        assert_eq!(last.codes.lower, lower[132 - RECEPTIVE..]);
        assert!(plan.is_complete() && plan.next(known(228)).is_none());
    }

    #[test]
    fn the_dance_before_is_seen_by_the_first_chunk() {
        let history = Codes {
            upper: vec![7; 40],
            lower: vec![8; 40],
        };
        let mut plan = ChunkPlan::new(2, history, RECEPTIVE);
        let chunk = plan.next([&[1, 2], &[3, 4]]).unwrap();
        assert_eq!((chunk.before, chunk.length), (RECEPTIVE, 2));
        assert_eq!(chunk.codes.upper[RECEPTIVE - 1..], [7, 1, 2]);
        assert_eq!(chunk.codes.lower[RECEPTIVE - 1..], [8, 3, 4]);
    }
}
