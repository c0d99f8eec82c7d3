//! Where a motion begins and ends on the floor, and what a later one must know to continue it.

use super::{GenerationOptions, codes::halves};
use crate::{
    formats::Continuation,
    model::{ModelDirectory, code_pairs},
};

/// Most pose codes in a tail, so that it fits into the value of an option.
const LONGEST_TAIL: usize = 43;
/// Largest vocabulary whose codes a tail can hold.
const MOST_TAIL_CODES: usize = 1 << 16;

/// The end of an earlier motion, which a new one continues; nothing where it starts afresh.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Prompt {
    /// The last codes. The very last is given to the model as the first one of the new motion.
    pub(crate) codes: Vec<[u32; 2]>,
    /// Where the root starts on the floor: x and z in metres.
    pub(crate) place: [f32; 2],
    /// Heading of the first pose, radians about +y from +z.
    pub(crate) heading: f32,
}

/// Where a motion has come to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ending {
    /// Metres from the start, x and z.
    pub(crate) walked: [f32; 2],
    /// Heading of the next pose, radians about +y from +z.
    pub(crate) heading: f32,
}

impl Prompt {
    /// Of the options, whose check has found the tail's halves to be of one length.
    pub(crate) fn of(options: &GenerationOptions) -> Self {
        let Some(tail) = &options.continue_from else {
            return Self::default();
        };
        Self {
            codes: code_pairs(&tail.codes.upper, &tail.codes.lower)
                .unwrap_or_else(|_| unreachable!("the options were checked")),
            place: tail.position,
            heading: tail.heading,
        }
    }

    /// What a motion after this one's `codes` must know; none if a tail cannot hold the codes of
    /// the model. A dancer that is held in place is held at 0, wherever the motion before ended.
    pub(crate) fn tail(
        &self,
        codes: &[[u32; 2]],
        ending: Ending,
        root_motion: bool,
        directory: &ModelDirectory,
    ) -> Option<Continuation> {
        let manifest = directory.manifest();
        let vocabulary = manifest.vocabulary;
        if vocabulary.upper.max(vocabulary.lower) > MOST_TAIL_CODES {
            return None;
        }
        let count = (manifest.decoder.receptive_codes + 1).min(LONGEST_TAIL);
        let codes = halves(&self.last_codes(codes, count));
        let place = self.place_after(ending.walked, root_motion);
        let sha256 = directory.manifest_sha256();
        let tail = Continuation::new(sha256, codes, place, ending.heading);
        tail.is_readable().then_some(tail)
    }

    fn place_after(&self, walked: [f32; 2], root_motion: bool) -> [f32; 2] {
        match root_motion {
            true => [0, 1].map(|axis| self.place[axis] + walked[axis]),
            false => [0.0; 2],
        }
    }

    /// The last `count` codes, those of the prompt included where there are fewer new ones.
    fn last_codes(&self, codes: &[[u32; 2]], count: usize) -> Vec<[u32; 2]> {
        let length = self.codes.len() + codes.len();
        let all = self.codes.iter().chain(codes);
        all.skip(length.saturating_sub(count)).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_ends_where_it_walked_to_or_where_it_was_held() {
        let before = Prompt { place: [3.0, -2.0], ..Prompt::default() };
        assert_eq!(before.place_after([0.5, 1.0], true), [3.5, -1.0]);
        assert_eq!(before.place_after([0.5, 1.0], false), [0.0, 0.0]);
    }

    #[test]
    fn a_short_motion_leaves_the_codes_before_it_as_well() {
        let before = Prompt { codes: vec![[1, 101], [2, 102]], ..Prompt::default() };
        let last = |count| before.last_codes(&[[3, 103], [4, 104]], count);
        assert_eq!(last(3), [[2, 102], [3, 103], [4, 104]]);
        assert_eq!(last(1), [[4, 104]]);
        assert_eq!(last(9), [[1, 101], [2, 102], [3, 103], [4, 104]]);
    }
}
