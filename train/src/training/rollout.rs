//! What an epoch of `actor-critic` learns from: pieces by the policy as it was at the epoch's
//! start, and their rewards (ARCHITECTURE section 6).

use ndarray::{ArrayView2, Axis, Slice};
use rand_chacha::rand_core::Rng;
use rayon::prelude::*;

use super::{
    FRAMES_PER_CODE,
    decode::DanceDecoder,
    reward::RewardRule,
    sampling::{Sampler, Wish, unit},
    saved::Saved,
    song::Song,
    windows::generator,
};
use crate::{Tensor, nn::Kernels};

/// A generator's seed for each purpose.
const EXCERPTS: u64 = 0x6578_6370;
const PIECES: u64 = 0x7069_6563;
const ORDER: u64 = 0x6f72_6465;
const CONTINUED: u64 = 0x636f_6e74;
/// Names in checkpoints.
const EPOCH: &str = "rollout.epoch";
const CODES: &str = "rollout.codes";
const REWARDS: &str = "rollout.rewards";
const MEANS: &str = "rollout.means";

/// What is generated in every epoch.
pub(super) struct Repertoire {
    /// Scaled rows, and beats.
    pub(super) songs: Vec<Song>,
    /// Pieces of an epoch.
    pub(super) pieces: usize,
    /// Longest piece in codes.
    pub(super) codes: usize,
    /// Pieces that are danced to each excerpt, from the same start.
    pub(super) takes: usize,
    /// Share of pieces that go on from the last codes of an earlier epoch's.
    pub(super) continued: f64,
    /// States of a window.
    pub(super) block: usize,
    pub(super) seed: u64,
}

/// The part of a song that a piece is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Excerpt {
    song: usize,
    /// First row of music, and first code.
    first: usize,
    codes: usize,
}

/// A generated piece.
pub(super) struct Episode {
    pub(super) excerpt: Excerpt,
    /// Upper and lower codes.
    pub(super) codes: [Vec<i32>; 2],
    /// Total, `R_b` and `R_c` of every code; with several takes, less the mean over these.
    pub(super) rewards: Rewards,
}

/// The pieces of an epoch, and the order in which their windows are learned from.
pub(super) struct Rollout {
    pub(super) epoch: u64,
    pub(super) episodes: Vec<Episode>,
    /// Means of total, `R_b` and `R_c` over all codes.
    pub(super) mean_rewards: [f32; 3],
    /// A piece and a window's first code each.
    windows: Vec<(usize, usize)>,
}

impl Repertoire {
    /// Codes that a song allows: each needs the row of music beside it, one later.
    fn longest(&self, song: &Song) -> usize {
        song.rows.nrows().saturating_sub(1).min(self.codes)
    }

    /// Leaves out songs that are too short for a window.
    pub(super) fn keep_usable(&mut self) {
        let mut songs = std::mem::take(&mut self.songs);
        songs.retain(|song| self.longest(song) >= self.block);
        self.songs = songs;
    }

    /// Windows of an epoch, as many as its pieces have on average.
    pub(super) fn windows(&self) -> usize {
        let songs = self.songs.iter();
        let all: usize = songs.map(|song| self.longest(song) - self.block + 1).sum();
        (all * self.pieces).div_ceil(self.songs.len().max(1))
    }

    /// Which parts of which songs an epoch is about: songs in a random order, again from the start
    /// where there are fewer than pieces, each from a random row on.
    pub(super) fn excerpts(&self, epoch: u64) -> Vec<Excerpt> {
        let mut random = generator(self.seed ^ EXCERPTS, epoch);
        let order = shuffled((0..self.songs.len()).collect(), &mut random);
        let takes = self.takes;
        let songs = order.iter().cycle().take(self.pieces.div_ceil(takes));
        let excerpts = songs.flat_map(|&song| {
            let codes = self.longest(&self.songs[song]);
            let spare = self.songs[song].rows.nrows() - 1 - codes;
            let first = (unit(&mut random) * (spare + 1) as f64) as usize;
            std::iter::repeat_n(Excerpt { song, first, codes }, takes)
        });
        excerpts.take(self.pieces).collect()
    }

    /// Scaled music of an excerpt: row `k + 1` is beside code `k`.
    pub(super) fn music(&self, excerpt: Excerpt) -> ArrayView2<'_, f32> {
        let rows = excerpt.first..excerpt.first + excerpt.codes + 1;
        self.songs[excerpt.song]
            .rows
            .slice_axis(Axis(0), Slice::from(rows))
    }

    fn beats(&self, excerpt: Excerpt) -> &[bool] {
        let beats = &self.songs[excerpt.song].beats;
        beats
            .get(excerpt.first * FRAMES_PER_CODE..)
            .unwrap_or_default()
    }

    /// The codes to go on from, of those that earlier pieces ended with; none where the piece starts anew.
    fn continued_from(&self, epoch: u64, piece: usize, ends: &[[i32; 2]]) -> Option<[i32; 2]> {
        let mut random = generator(self.seed ^ CONTINUED, epoch << 32 | piece as u64);
        let goes_on = unit(&mut random) < self.continued;
        let end = (unit(&mut random) * ends.len() as f64) as usize;
        ends.get(end).copied().filter(|_| goes_on)
    }

    /// Generates and judges the pieces of an epoch, `batch` at a time; a start is one of `starts`, or what an
    /// `earlier` epoch's piece ended with.
    pub(super) fn roll_out<B: Kernels>(
        &self,
        epoch: u64,
        sampler: &Sampler<'_, B>,
        starts: &[[u32; 2]],
        earlier: Option<&Rollout>,
        batch: usize,
        judge: &Judge,
    ) -> Rollout {
        let excerpts = self.excerpts(epoch);
        let takes = self.takes;
        let ends = earlier.map(Rollout::ends).unwrap_or_default();
        let wishes = excerpts.iter().enumerate().map(|(piece, &excerpt)| {
            let random = |piece: usize| generator(self.seed ^ PIECES, epoch << 32 | piece as u64);
            // All takes start as the first does.
            let first = piece / takes * takes;
            let anew = || Wish::new(self.music(excerpt), starts, random(first)).start;
            let start = self.continued_from(epoch, first, &ends);
            Wish {
                start: start.unwrap_or_else(anew),
                ..Wish::new(self.music(excerpt), starts, random(piece))
            }
        });
        let mut wishes = wishes.peekable();
        let mut codes = Vec::with_capacity(excerpts.len());
        while wishes.peek().is_some() {
            codes.extend(sampler.generate(wishes.by_ref().take(batch).collect()));
        }
        let beats: Vec<&[bool]> = excerpts
            .iter()
            .map(|&excerpt| self.beats(excerpt))
            .collect();
        let rewards = judge(&codes, &beats);
        let judged = excerpts.into_iter().zip(codes).zip(rewards);
        let mut episodes: Vec<Episode> = judged
            .map(|((excerpt, codes), rewards)| Episode {
                excerpt,
                codes,
                rewards,
            })
            .collect();
        let mean_rewards = mean_rewards(&episodes);
        if takes > 1 {
            episodes.chunks_mut(takes).for_each(compare);
        }
        self.arranged(epoch, mean_rewards, episodes)
    }

    /// The windows of an epoch's pieces, in an order of their own.
    pub(super) fn arranged(
        &self,
        epoch: u64,
        mean_rewards: [f32; 3],
        episodes: Vec<Episode>,
    ) -> Rollout {
        let windows = episodes.iter().enumerate().flat_map(|(piece, episode)| {
            let starts = 0..=episode.excerpt.codes - self.block;
            starts.map(move |start| (piece, start))
        });
        let mut random = generator(self.seed ^ ORDER, epoch);
        Rollout {
            epoch,
            mean_rewards,
            windows: shuffled(windows.collect(), &mut random),
            episodes,
        }
    }

    /// The opposite of [`Rollout::save`].
    pub(super) fn restore(&self, saved: &Saved) -> Result<Option<Rollout>, String> {
        let Ok(epoch) = saved.tensor(EPOCH) else {
            return Ok(None);
        };
        let epoch = epoch.data().first().map_or(0, |&epoch| epoch as u64);
        let mut codes = saved.tensor(CODES)?.data().as_chunks::<2>().0.iter();
        let mut rewards = saved.tensor(REWARDS)?.data().as_chunks::<3>().0.iter();
        let episodes = self.excerpts(epoch).into_iter().map(|excerpt| {
            let codes: Vec<[f32; 2]> = codes.by_ref().take(excerpt.codes).copied().collect();
            let rewards: Vec<[f32; 3]> = rewards.by_ref().take(excerpt.codes).copied().collect();
            if (codes.len(), rewards.len()) != (excerpt.codes, excerpt.codes) {
                return Err("holds pieces of other songs".to_owned());
            }
            Ok(Episode {
                excerpt,
                codes: [0, 1].map(|half| codes.iter().map(|pair| pair[half] as i32).collect()),
                rewards,
            })
        });
        let means = saved.tensor(MEANS)?.data();
        let means = [0, 1, 2].map(|part| means.get(part).copied().unwrap_or_default());
        let episodes = episodes.collect::<Result<_, _>>()?;
        Ok(Some(self.arranged(epoch, means, episodes)))
    }
}

impl Rollout {
    /// Upper and lower code that each piece ended with.
    fn ends(&self) -> Vec<[i32; 2]> {
        let ends = self.episodes.iter().filter_map(|episode| {
            let [upper, lower] = &episode.codes;
            Some([*upper.last()?, *lower.last()?])
        });
        ends.collect()
    }

    /// The windows of the epoch's `step`-th batch: a piece and the first code each. They start over
    /// where an epoch has a few steps more than windows.
    pub(super) fn batch(&self, step: u64, size: usize) -> Vec<(usize, usize)> {
        let size = size.min(self.windows.len());
        let first = step as usize * size % self.windows.len().max(1);
        let windows = self.windows.iter().cycle().skip(first);
        windows.take(size).copied().collect()
    }

    /// What was generated is kept: its policy is gone after the epoch's first step.
    pub(super) fn save(&self, saved: &mut Saved) {
        let episodes = &self.episodes;
        let codes = episodes.iter().flat_map(|episode| {
            let [upper, lower] = &episode.codes;
            upper
                .iter()
                .zip(lower)
                .flat_map(|(&upper, &lower)| [upper as f32, lower as f32])
        });
        let rewards = episodes.iter().flat_map(|episode| episode.rewards.concat());
        let mut put = |name: &str, width: usize, values: Vec<f32>| {
            let tensor = Tensor::from_fn(vec![values.len() / width, width], |place| values[place]);
            saved.tensors.insert(name.into(), tensor);
        };
        put(MEANS, 1, self.mean_rewards.to_vec());
        put(EPOCH, 1, vec![self.epoch as f32]);
        put(CODES, 2, codes.collect());
        put(REWARDS, 3, rewards.collect());
    }
}

/// Means of total, `R_b` and `R_c` over all codes.
fn mean_rewards(episodes: &[Episode]) -> [f32; 3] {
    let rewards = episodes.iter().flat_map(|episode| &episode.rewards);
    let mut sums = [0.0_f64; 3];
    let mut count = 0.0;
    for reward in rewards {
        count += 1.0;
        for (sum, &part) in sums.iter_mut().zip(reward) {
            *sum += f64::from(part);
        }
    }
    sums.map(|sum| (sum / count) as f32)
}

/// Takes from every reward the mean over the takes at the same code: what the music and the start are worth
/// is the same for all of them, and says nothing about a take.
fn compare(takes: &mut [Episode]) {
    let count = takes.len() as f32;
    let codes = takes.iter().map(|take| take.rewards.len()).min();
    for code in 0..codes.unwrap_or(0) {
        for part in 0..3 {
            let mean = takes
                .iter()
                .map(|take| take.rewards[code][part])
                .sum::<f32>()
                / count;
            for take in takes.iter_mut() {
                take.rewards[code][part] -= mean;
            }
        }
    }
}

/// Total, `R_b` and `R_c` of each code of a piece.
pub(super) type Rewards = Vec<[f32; 3]>;
/// Tells the rewards of pieces from their codes and their music's beats.
pub(super) type Judge = Box<dyn Fn(&[[Vec<i32>; 2]], &[&[bool]]) -> Vec<Rewards>>;

/// Judges by the decoded dance; pieces are decoded whole. No numbers where the decoder gives none,
/// which ends the run.
pub(super) fn judge<B: Kernels>(decoder: DanceDecoder<B>, rule: RewardRule) -> Judge {
    Box::new(move |pieces, music_beats| {
        let positions = decoder.positions_of_many(pieces);
        let judged = positions.par_iter().zip(pieces).zip(music_beats);
        let rewards = judged.map(|((positions, codes), music_beats)| {
            let Some(positions) = positions else {
                return vec![[f32::NAN; 3]; codes[0].len()];
            };
            let rewards = rule.rewards(positions, music_beats).into_iter();
            let rewards = rewards.map(|reward| [reward.total, reward.beat, reward.consistency]);
            rewards
                .map(|reward| reward.map(|part| part as f32))
                .collect()
        });
        rewards.collect()
    })
}

fn shuffled<T>(mut values: Vec<T>, random: &mut impl Rng) -> Vec<T> {
    for place in (1..values.len()).rev() {
        let other = random.next_u64() % (place as u64 + 1);
        values.swap(place, other as usize);
    }
    values
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    fn repertoire() -> Repertoire {
        let song = |rows: usize| Song {
            rows: Array2::zeros((rows, 2)),
            beats: (0..8 * rows).map(|frame| frame == 16).collect(),
        };
        let mut repertoire = Repertoire {
            songs: vec![song(12), song(4), song(30)],
            pieces: 5,
            codes: 16,
            takes: 1,
            continued: 0.0,
            block: 6,
            seed: 3,
        };
        repertoire.keep_usable();
        repertoire
    }

    #[test]
    fn takes_are_compared_with_each_other() {
        let repertoire = Repertoire {
            takes: 2,
            ..repertoire()
        };
        let excerpts = repertoire.excerpts(4);
        assert_eq!(excerpts.len(), 5);
        assert_eq!((excerpts[0], excerpts[2]), (excerpts[1], excerpts[3]));
        let take = |rewards: [f32; 2]| Episode {
            excerpt: excerpts[0],
            codes: [vec![0; 2], vec![0; 2]],
            rewards: rewards.map(|reward| [reward, 1.0, 2.0 * reward]).to_vec(),
        };
        let mut takes = [take([1.0, 5.0]), take([3.0, -5.0])];
        assert_eq!(mean_rewards(&takes), [1.0, 1.0, 2.0]);
        compare(&mut takes);
        assert_eq!(takes[0].rewards, [[-1.0, 0.0, -2.0], [5.0, 0.0, 10.0]]);
        assert_eq!(takes[1].rewards, [[1.0, 0.0, 2.0], [-5.0, 0.0, -10.0]]);
    }

    #[test]
    fn pieces_go_on_from_earlier_ends_as_often_as_asked() {
        let share = |continued: f64, ends: &[[i32; 2]]| {
            let repertoire = Repertoire {
                continued,
                ..repertoire()
            };
            let found = (0..1000).filter_map(|piece| repertoire.continued_from(2, piece, ends));
            let found: Vec<_> = found.collect();
            assert!(found.iter().all(|end| ends.contains(end)));
            let distinct: std::collections::HashSet<_> = found.iter().collect();
            (found.len(), distinct.len())
        };
        let ends = [[1, 2], [3, 4], [5, 6]];
        assert_eq!(share(0.0, &ends), (0, 0));
        assert_eq!(share(1.0, &ends), (1000, 3));
        assert_eq!(share(1.0, &[]), (0, 0));
        let (found, distinct) = share(0.8, &ends);
        assert!((760..840).contains(&found) && distinct == 3, "{found}");
        assert_eq!(rollout(3).ends()[2], [2, 4]);
    }

    fn rollout(epoch: u64) -> Rollout {
        let repertoire = repertoire();
        let excerpts = repertoire.excerpts(epoch).into_iter().enumerate();
        let episodes = excerpts.map(|(piece, excerpt)| Episode {
            excerpt,
            codes: [1, 2].map(|half| vec![half * piece as i32; excerpt.codes]),
            rewards: vec![[piece as f32, 0.1, -0.3]; excerpt.codes],
        });
        repertoire.arranged(epoch, [0.5, 0.1, -0.3], episodes.collect())
    }

    #[test]
    fn excerpts_lie_within_their_songs() {
        let repertoire = repertoire();
        assert_eq!(repertoire.songs.len(), 2);
        let mut firsts = Vec::new();
        for epoch in 0..20 {
            let excerpts = repertoire.excerpts(epoch);
            assert_eq!(excerpts, repertoire.excerpts(epoch));
            assert_eq!(excerpts.len(), 5);
            for excerpt in excerpts {
                let rows = repertoire.songs[excerpt.song].rows.nrows();
                assert_eq!(excerpt.codes, 16.min(rows - 1));
                assert_eq!(repertoire.music(excerpt).nrows(), excerpt.codes + 1);
                let beat = repertoire.beats(excerpt).iter().position(|&beat| beat);
                assert_eq!(beat, 16_usize.checked_sub(8 * excerpt.first));
                firsts.push(excerpt.first);
            }
        }
        firsts.sort_unstable();
        firsts.dedup();
        assert_eq!(firsts, (0..=13).collect::<Vec<_>>());
    }

    #[test]
    fn an_epoch_is_about_every_window_once() {
        let rollout = rollout(2);
        let mut drawn: Vec<_> = (0..).map(|step| rollout.batch(step, 7)).take(30).collect();
        let windows = rollout.windows.len();
        drawn.truncate(windows.div_ceil(7));
        let mut drawn = drawn.concat();
        // The last batch starts over.
        assert_eq!(
            drawn.split_off(windows),
            drawn[..drawn.len().div_ceil(7) * 7 - windows]
        );
        drawn.sort_unstable();
        let all = rollout.episodes.iter().enumerate();
        let all = all.flat_map(|(piece, e)| (0..=e.codes[0].len() - 6).map(move |at| (piece, at)));
        assert_eq!(drawn, all.collect::<Vec<_>>());
    }

    #[test]
    fn what_was_generated_is_kept() {
        let (repertoire, rollout) = (repertoire(), rollout(9));
        let mut saved = Saved::default();
        assert!(repertoire.restore(&saved).unwrap().is_none());
        rollout.save(&mut saved);
        let back = repertoire.restore(&saved).unwrap().unwrap();
        assert_eq!((back.epoch, &back.windows), (9, &rollout.windows));
        assert_eq!(back.mean_rewards, rollout.mean_rewards);
        for (found, wanted) in back.episodes.iter().zip(&rollout.episodes) {
            assert_eq!(found.excerpt, wanted.excerpt);
            assert_eq!(found.codes, wanted.codes);
            assert_eq!(found.rewards, wanted.rewards);
        }
        saved
            .tensors
            .insert(CODES.into(), Tensor::from_fn(vec![3, 2], |_| 0.0));
        assert!(repertoire.restore(&saved).is_err());
    }
}
