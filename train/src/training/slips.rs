//! Pasts that are not the recording's: codes replaced by any others, and codes that slip off the beat.
//!
//! Recorded dances are in time with their music, so a model that only ever saw them follows its own past
//! codes: once it dances a passage in another tempo than the song's, nothing calls it back. Here a
//! window's past comes piece by piece from a little earlier or later in the same dance, and what follows
//! each code is learned as the recording has it: where past and music disagree about the beat, the music is right.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{FRAMES_PER_CODE, codes::Codes, config::GptConfig};
use crate::data::Draw;

/// Most codes that slip together; then it is by how much that is drawn anew.
const LONGEST: usize = 16;
/// Share of these that do not slip.
const STEADY: f64 = 0.25;

/// How many windows slip, and how far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slips {
    /// Share of the windows.
    pub(super) share: f64,
    /// Frames early or late, at most.
    pub(super) frames: usize,
    /// Codes of a window.
    pub(super) block: usize,
}

/// What a window shows instead of its own codes.
pub(super) type Slipped = [Vec<i32>; 2];

impl Slips {
    /// As configured; `None` where no window slips.
    pub(super) fn new(config: &GptConfig) -> Option<Self> {
        (config.slip_share > 0.0).then_some(Self {
            share: config.slip_share,
            frames: config.slip_frames,
            block: config.block,
        })
    }

    /// The past of each window, or nothing where it stays as it is.
    pub(super) fn draw(
        &self,
        codes: &Codes,
        windows: &[Draw],
        random: &mut ChaCha8Rng,
    ) -> Vec<Option<Slipped>> {
        let mut one = |window: &Draw| {
            let slips = random.random_bool(self.share);
            slips.then(|| self.slipped(codes, window, random))
        };
        windows.iter().map(&mut one).collect()
    }

    fn slipped(&self, codes: &Codes, window: &Draw, random: &mut ChaCha8Rng) -> Slipped {
        let mut slipped = Slipped::default();
        while slipped[0].len() < self.block {
            let known = slipped[0].len();
            let count = random.random_range(1..=LONGEST).min(self.block - known);
            let frame = window.phase + window.start + FRAMES_PER_CODE * known;
            // Small ones are likelier: so it is where a dance is called back in time.
            let mut part = || random.random_range(0..=self.frames);
            let offset = part() + part();
            let slipping = (frame + offset)
                .checked_sub(self.frames)
                .filter(|_| !random.random_bool(STEADY))
                .and_then(|frame| run(codes, window, frame, count));
            let own = || run(codes, window, frame, count);
            // A window's own codes are always there.
            let Some(run) = slipping.or_else(own) else {
                break;
            };
            for (half, run) in slipped.iter_mut().zip(run) {
                half.extend_from_slice(run);
            }
        }
        slipped
    }
}

/// So many codes of the window's dance from a frame on, if it has them.
fn run<'a>(codes: &'a Codes, window: &Draw, frame: usize, count: usize) -> Option<[&'a [i32]; 2]> {
    let [upper, lower] = codes.beginning_at(window, frame)?;
    Some([upper.get(..count)?, lower.get(..count)?])
}

/// How the past codes of a step's windows differ from the recordings'.
pub(super) struct Disturbance {
    /// One for each window, or an empty list.
    pub(super) slips: Vec<Option<Slipped>>,
    /// Share of codes replaced by any of `codes` others.
    pub(super) noise: f64,
    pub(super) codes: i32,
    pub(super) random: ChaCha8Rng,
}

impl Disturbance {
    /// Disturbs the codes of a half, `[windows, block]`.
    pub(super) fn disturb(&mut self, codes: &mut [i32], half: usize, block: usize) {
        let windows = codes.chunks_exact_mut(block).zip(&self.slips);
        for (codes, slip) in windows {
            let slipped = slip.iter().flat_map(|slip| &slip[half]);
            for (code, &slipped) in codes.iter_mut().zip(slipped) {
                *code = slipped;
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

    /// Of a dance whose upper code is the frame that it begins at, and the lower one that much below 0.
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
        Draw {
            dance: 0,
            song: 0,
            phase: 0,
            start,
            mirrored: false,
        }
    }

    fn slips(share: f64) -> Slips {
        Slips {
            share,
            frames: 11,
            block: BLOCK,
        }
    }

    #[test]
    fn a_slipped_past_is_the_same_dance_a_little_earlier_or_later() {
        let windows = vec![window(16); 400];
        let draw = |share| slips(share).draw(&codes(), &windows, &mut generator(1, 0));
        let found = draw(0.5);
        assert_eq!(found, draw(0.5));
        assert!(draw(0.0).iter().all(Option::is_none));
        let slipped: Vec<&Slipped> = found.iter().flatten().collect();
        assert!((140..260).contains(&slipped.len()), "{}", slipped.len());
        let mut steady = 0;
        let mut offsets = Vec::new();
        for [upper, lower] in &slipped {
            assert_eq!(upper.len(), BLOCK);
            assert!(
                upper
                    .iter()
                    .zip(lower)
                    .all(|(upper, lower)| *upper == -lower)
            );
            let own = (16..).step_by(PHASES);
            let apart: Vec<i32> = upper
                .iter()
                .zip(own)
                .map(|(code, own)| code - own)
                .collect();
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
    fn a_window_at_the_dances_end_slips_only_to_what_there_is() {
        for start in [0, PHASES * (LENGTH - BLOCK)] {
            let found = slips(1.0).draw(&codes(), &[window(start); 50], &mut generator(2, 0));
            let all = found.iter().flatten().flat_map(|[upper, _]| upper);
            assert_eq!(all.clone().count(), 50 * BLOCK);
            assert!(
                all.into_iter()
                    .all(|code| (0..(PHASES * LENGTH) as i32).contains(code))
            );
        }
    }

    #[test]
    fn what_slipped_is_shown() {
        let mut disturbance = Disturbance {
            slips: vec![Some([vec![7, 8, 9], vec![-7, -8, -9]]), None],
            noise: 0.0,
            codes: 10,
            random: generator(1, 0),
        };
        let mut lower = [1, 2, 3, 4, 5, 6];
        disturbance.disturb(&mut lower, 1, 3);
        assert_eq!(lower, [-7, -8, -9, 4, 5, 6]);
    }

    #[test]
    fn noise_replaces_its_share_of_the_codes() {
        let mut disturbance = Disturbance {
            slips: Vec::new(),
            noise: 0.25,
            codes: 10,
            random: generator(1, 0),
        };
        let mut codes = vec![-1; 4_000];
        disturbance.disturb(&mut codes, 0, 40);
        let replaced = codes.iter().filter(|&&code| code != -1);
        assert!(replaced.clone().all(|code| (0..10).contains(code)));
        assert!((900..1_100).contains(&replaced.count()));
    }
}
