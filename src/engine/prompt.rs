//! Where a motion begins and ends on the floor, and what a later one must know to continue it.

use super::{GenerationOptions, conditioning::PROMPT_CODES};
use crate::{
    formats::{Codes, Continuation},
    model::{ModelDirectory, code_pairs},
    motion::Seam,
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
    /// Frames of the last code that were shown, where the earlier motion ended inside it: the new
    /// one begins with the others. 0: all of them.
    pub(crate) shown: usize,
    /// Pose and speed of the first frame, as the earlier motion would have gone on.
    pub(crate) seam: Option<Seam>,
}

/// Where a motion has come to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ending {
    /// Metres from the start, x and z.
    pub(crate) walked: [f32; 2],
    /// Heading of the next pose, radians about +y from +z.
    pub(crate) heading: f32,
    /// Frames of the motion.
    pub(crate) frames: usize,
}

/// What becomes of the path of a decoded motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moved {
    /// Whether the dancer travels, or is held in place.
    pub(crate) travels: bool,
    /// Whether left and right are exchanged.
    pub(crate) mirrored: bool,
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
            shown: tail.shown.into(),
            seam: tail.seam.clone(),
        }
    }

    /// Codes that the new motion is given.
    pub(crate) fn given(&self) -> usize {
        if self.codes.is_empty() { 0 } else { PROMPT_CODES }
    }

    /// Decoded frames of so many new codes, with those that are left of the prompt's last code.
    pub(crate) fn frames_with(&self, codes: usize, per_code: usize) -> usize {
        codes * per_code + (per_code - self.shown) % per_code
    }

    /// What a motion after this one's `codes` must know; none if a tail cannot hold the codes of
    /// the model. A dancer that is held in place is held at 0, wherever the motion before ended.
    pub(crate) fn tail(
        &self,
        codes: &[[u32; 2]],
        ending: Ending,
        moved: Moved,
        directory: &ModelDirectory,
    ) -> Option<Continuation> {
        let manifest = directory.manifest();
        let vocabulary = manifest.vocabulary;
        if vocabulary.upper.max(vocabulary.lower) > MOST_TAIL_CODES {
            return None;
        }
        let count = (manifest.decoder.receptive_codes + 1).min(LONGEST_TAIL);
        let (codes, shown) = self.shown_codes(codes, ending.frames, manifest.frames_per_code);
        let codes = Codes::of_pairs(&codes[codes.len().saturating_sub(count)..]);
        let place = self.place_after(ending.walked, moved);
        let sha256 = directory.manifest_sha256();
        let heading = if moved.mirrored { -ending.heading } else { ending.heading };
        let mut tail = Continuation::new(sha256, codes, place, heading);
        tail.shown = u8::try_from(shown).ok()?;
        tail.is_readable().then_some(tail)
    }

    fn place_after(&self, [x, z]: [f32; 2], moved: Moved) -> [f32; 2] {
        let x = if moved.mirrored { -x } else { x };
        match moved.travels {
            true => [self.place[0] + x, self.place[1] + z],
            false => [0.0; 2],
        }
    }

    /// The codes of the prompt and the new ones up to the last of which a motion of so many frames
    /// shows something, and how many frames of that one it shows; 0 for all.
    fn shown_codes(
        &self,
        codes: &[[u32; 2]],
        frames: usize,
        per_code: usize,
    ) -> (Vec<[u32; 2]>, usize) {
        let frames = self.shown + frames;
        // The prompt's last code counts where the motion began inside it.
        let before = self.codes.len() - usize::from(self.shown > 0);
        let all = self.codes.iter().chain(codes).copied();
        (all.take(before + frames.div_ceil(per_code)).collect(), frames % per_code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_ends_where_it_walked_to_or_where_it_was_held() {
        let before = Prompt { place: [3.0, -2.0], ..Prompt::default() };
        let after = |travels, mirrored| before.place_after([0.5, 1.0], Moved { travels, mirrored });
        assert_eq!(after(true, false), [3.5, -1.0]);
        assert_eq!(after(true, true), [2.5, -1.0]);
        assert_eq!(after(false, false), [0.0, 0.0]);
    }

    #[test]
    fn a_motion_ends_inside_a_code_and_the_next_one_begins_there() {
        let before = Prompt { codes: vec![[1, 101], [2, 102]], ..Prompt::default() };
        let new = [[3, 103], [4, 104]];
        let shown = |prompt: &Prompt, frames| {
            let (codes, shown) = prompt.shown_codes(&new, frames, 8);
            (codes.last().copied().unwrap()[0], codes.len(), shown)
        };
        assert_eq!(shown(&before, 16), (4, 4, 0));
        assert_eq!(shown(&before, 11), (4, 4, 3));
        assert_eq!(shown(&before, 8), (3, 3, 0));
        // Three frames of the prompt's last code were shown: five are left of it.
        let inside = Prompt { shown: 3, ..before };
        assert_eq!(shown(&inside, 5), (2, 2, 0));
        assert_eq!(shown(&inside, 2), (2, 2, 5));
        assert_eq!(shown(&inside, 14), (4, 4, 1));
    }
}
