//! Corrupted pasts: codes replaced by random ones, and codes shifted in time.
//!
//! Recordings are in time with their music, so a model of them may follow its own past codes alone:
//! once it generates a passage in another tempo than the song's, nothing corrects it. Here parts of
//! a window's past come from a little earlier or later in the same motion, while the targets stay
//! those of the recording: where past and music disagree about the beat, the music is right.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{codes::Codes, config::GptConfig};
use crate::data::{Draw, FRAMES_PER_CODE};

/// Most codes that are shifted together; after them another shift is drawn.
const LONGEST: usize = 16;
/// Share of these runs that are not shifted.
const STEADY: f64 = 0.25;

/// Shifts parts of a window's past in time.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeShiftAugmentation {
    /// Share of the windows.
    pub(super) share: f64,
    /// Frames early or late, at most.
    pub(super) frames: usize,
    /// Codes of a window.
    pub(super) block: usize,
}

/// Codes that replace those of a window.
pub(super) type ShiftedCodes = [Vec<i32>; 2];

impl TimeShiftAugmentation {
    /// Takes the settings; `None` where no window is shifted.
    pub(super) fn new(config: &GptConfig) -> Option<Self> {
        (config.shift_share > 0.0).then_some(Self {
            share: config.shift_share,
            frames: config.shift_frames,
            block: config.block,
        })
    }

    /// Draws the past of each window; `None` where it stays as it is.
    pub(super) fn draw(
        &self,
        codes: &Codes,
        windows: &[Draw],
        random: &mut ChaCha8Rng,
    ) -> Vec<Option<ShiftedCodes>> {
        let mut one = |window: &Draw| {
            let shifts = random.random_bool(self.share);
            shifts.then(|| self.shifted(codes, window, random))
        };
        windows.iter().map(&mut one).collect()
    }

    fn shifted(&self, codes: &Codes, window: &Draw, random: &mut ChaCha8Rng) -> ShiftedCodes {
        let mut shifted = ShiftedCodes::default();
        while shifted[0].len() < self.block {
            let known = shifted[0].len();
            let count = random.random_range(1..=LONGEST).min(self.block - known);
            let frame = window.phase + window.start + FRAMES_PER_CODE * known;
            // Small shifts are likelier, as they are where the music corrects the timing early.
            let mut part = || random.random_range(0..=self.frames);
            let offset = part() + part();
            let shift = (frame + offset)
                .checked_sub(self.frames)
                .filter(|_| !random.random_bool(STEADY))
                .and_then(|frame| run(codes, window, frame, count));
            let own = || run(codes, window, frame, count);
            // A window's own codes always exist.
            let Some(run) = shift.or_else(own) else {
                break;
            };
            for (half, run) in shifted.iter_mut().zip(run) {
                half.extend_from_slice(run);
            }
        }
        shifted
    }
}

/// Returns `count` codes of the window's motion from a frame on, if it has them.
fn run<'a>(codes: &'a Codes, window: &Draw, frame: usize, count: usize) -> Option<[&'a [i32]; 2]> {
    let [upper, lower] = codes.beginning_at(window, frame)?;
    Some([upper.get(..count)?, lower.get(..count)?])
}

/// Changes of the past codes of a step's windows.
pub(super) struct InputCorruption {
    /// One for each window, or an empty list.
    pub(super) shifts: Vec<Option<ShiftedCodes>>,
    /// Share of codes replaced by any of `codes` others.
    pub(super) noise: f64,
    pub(super) codes: i32,
    pub(super) random: ChaCha8Rng,
}

impl InputCorruption {
    /// Corrupts the codes of a half, `[windows, block]`.
    pub(super) fn apply(&mut self, codes: &mut [i32], half: usize, block: usize) {
        let windows = codes.chunks_exact_mut(block).zip(&self.shifts);
        for (codes, shift) in windows {
            let shifted = shift.iter().flat_map(|shift| &shift[half]);
            for (code, &shifted) in codes.iter_mut().zip(shifted) {
                *code = shifted;
            }
        }
        if self.noise > 0.0 {
            for code in codes {
                if self.random.random_bool(self.noise) {
                    *code = self.random.random_range(0..self.codes);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{data::PHASES, training::windows::generator};

    const BLOCK: usize = 6;
    const LENGTH: usize = 12;

    /// Returns the codes of a motion: upper codes are their first frame, lower ones its negative.
    fn codes() -> Codes {
        let phase = |phase: usize| {
            let frames = (0..LENGTH).map(|code| (PHASES * code + phase) as i32);
            let upper: Vec<i32> = frames.collect();
            let lower = upper.iter().map(|frame| -frame).collect();
            [upper, lower]
        };
        Codes::of_one((0..PHASES).map(phase).collect())
    }

    fn window(start: usize) -> Draw {
        Draw { start, ..Draw::default() }
    }

    fn augmentation(share: f64) -> TimeShiftAugmentation {
        TimeShiftAugmentation { share, frames: 11, block: BLOCK }
    }

    #[test]
    fn a_shifted_past_is_the_same_motion_a_little_earlier_or_later() {
        let windows = vec![window(16); 400];
        let draw = |share| augmentation(share).draw(&codes(), &windows, &mut generator(1, 0));
        let found = draw(0.5);
        assert_eq!(found, draw(0.5));
        assert!(draw(0.0).iter().all(Option::is_none));
        let shifted: Vec<&ShiftedCodes> = found.iter().flatten().collect();
        assert!((140..260).contains(&shifted.len()), "{}", shifted.len());
        let mut steady = 0;
        let mut offsets = Vec::new();
        for [upper, lower] in &shifted {
            assert_eq!(upper.len(), BLOCK);
            assert!(upper.iter().zip(lower).all(|(upper, lower)| *upper == -lower));
            let own = (16..).step_by(PHASES);
            let apart: Vec<i32> = upper.iter().zip(own).map(|(code, own)| code - own).collect();
            steady += apart.iter().filter(|&&frames| frames == 0).count();
            offsets.extend(apart);
        }
        let share = steady as f64 / offsets.len() as f64;
        assert!((0.15..0.45).contains(&share), "{share}");
        offsets.sort_unstable();
        offsets.dedup();
        assert_eq!(offsets, (-11..=11).collect::<Vec<i32>>());
    }

    #[test]
    fn a_window_at_the_end_is_shifted_only_to_codes_that_exist() {
        for start in [0, PHASES * (LENGTH - BLOCK)] {
            let found =
                augmentation(1.0).draw(&codes(), &[window(start); 50], &mut generator(2, 0));
            let all = found.iter().flatten().flat_map(|[upper, _]| upper);
            assert_eq!(all.clone().count(), 50 * BLOCK);
            assert!(all.into_iter().all(|code| (0..(PHASES * LENGTH) as i32).contains(code)));
        }
    }

    #[test]
    fn shifted_codes_replace_those_of_their_windows() {
        let mut corruption = InputCorruption {
            shifts: vec![Some([vec![7, 8, 9], vec![-7, -8, -9]]), None],
            noise: 0.0,
            codes: 10,
            random: generator(1, 0),
        };
        let mut lower = [1, 2, 3, 4, 5, 6];
        corruption.apply(&mut lower, 1, 3);
        assert_eq!(lower, [-7, -8, -9, 4, 5, 6]);
    }

    #[test]
    fn noise_replaces_its_share_of_the_codes() {
        let mut corruption =
            InputCorruption { shifts: Vec::new(), noise: 0.25, codes: 10, random: generator(1, 0) };
        let mut codes = vec![-1; 4_000];
        corruption.apply(&mut codes, 0, 40);
        let replaced = codes.iter().filter(|&&code| code != -1);
        assert!(replaced.clone().all(|code| (0..10).contains(code)));
        assert!((900..1_100).contains(&replaced.count()));
    }
}
