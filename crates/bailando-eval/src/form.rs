//! Agreement of a dance's form with its song's: whether bars that are alike in the music are alike
//! in the dance.

use bailando_features::{BeatPhase, Beats, Phrases, SelfSimilarity};
use ndarray::{Array3, ArrayView2};
use rand::{Rng, seq::SliceRandom};

use crate::body::{FRAMES_PER_SECOND, JOINTS, Pose, in_dancer_frame};

/// Counts of a bar.
const BAR: usize = 4;
/// Bars from one to the next that it is compared with: nearer ones are alike because music and
/// dance both go on.
const APART: usize = 2;
/// Fewer bars have no form.
const FEWEST: usize = 8;
/// Moments of a bar at which the dancer is looked at.
const MOMENTS: usize = 8;
/// Frames over which the dancer's speed is taken.
const STEP: usize = 3;
/// Random orders of the bars whose mean is the chance level.
const ORDERS: usize = 20;

/// The bars of a song, and how much each two are alike.
#[derive(Debug)]
pub(crate) struct SongForm {
    /// Frames of the bars' starts, and of the end of the last.
    bounds: Vec<usize>,
    similar: SelfSimilarity,
}

impl SongForm {
    /// Of feature rows `[rows, 438]`, 7.5 a second, and beats in frames at 60 a second; none
    /// without regular beats.
    pub(crate) fn new(rows: ArrayView2<'_, f32>, beats: &[usize]) -> Option<Self> {
        let beats = Beats { tempo_bpm: 0.0, frames: beats.to_vec() };
        let bars = Phrases::new(rows, &BeatPhase::find(&beats, rows)?, BAR);
        let bounds = bars.bounds_s().iter();
        Some(Self {
            bounds: bounds.map(|s| (s * FRAMES_PER_SECOND).round().max(0.0) as usize).collect(),
            similar: bars.self_similarity(),
        })
    }
}

/// Agreement of a dance's form with its song's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FormScore {
    /// Correlation of the likeness of two bars in the music with that in the dance, over all pairs
    /// of bars that are at least two bars apart.
    pub(crate) agreement: f64,
    /// The same with the dance's bars in random order, mean of 20.
    pub(crate) chance: f64,
}

impl FormScore {
    /// Scores a dance to a song; none below eight whole bars, or where all bars are the same.
    pub(crate) fn new(poses: &[Pose], song: &SongForm, random: &mut impl Rng) -> Option<Self> {
        let bars: Vec<_> = song.bounds.windows(2).map(|pair| pair[0]..pair[1]).collect();
        let whole = bars.into_iter().take_while(|bar| bar.end <= poses.len() && !bar.is_empty());
        let whole: Vec<_> = whole.collect();
        if whole.len() < FEWEST {
            return None;
        }
        let own: Vec<Pose> = poses.iter().map(in_dancer_frame).collect();
        let columns = 2 * JOINTS * 3;
        let bars =
            Array3::from_shape_fn((whole.len(), MOMENTS, columns), |(bar, moment, column)| {
                let bar = &whole[bar];
                let frame = bar.start + (2 * moment + 1) * bar.len() / (2 * MOMENTS);
                let (joint, axis) = (column / 3 % JOINTS, column % 3);
                let place = own[frame][joint][axis];
                let value = match column < JOINTS * 3 {
                    true => place,
                    false => place - own[frame.saturating_sub(STEP)][joint][axis],
                };
                value as f32
            });
        let dance = SelfSimilarity::new(&bars);
        let mut order: Vec<usize> = (0..whole.len()).collect();
        let agreement = agreement(&song.similar, &dance, &order)?;
        let chances = (0..ORDERS).map(|_| {
            order.shuffle(random);
            self::agreement(&song.similar, &dance, &order).unwrap_or(0.0)
        });
        Some(Self { agreement, chance: chances.sum::<f64>() / ORDERS as f64 })
    }
}

/// Correlation of the likenesses of music and dance, the dance's bars in an order.
fn agreement(music: &SelfSimilarity, dance: &SelfSimilarity, order: &[usize]) -> Option<f64> {
    let later = |bar: usize| (bar + APART..order.len()).map(move |other| (bar, other));
    let pairs = (0..order.len()).flat_map(later);
    let likenesses = pairs
        .map(|(one, other)| (music.of(one, other), dance.of(order[one], order[other])))
        .collect::<Vec<_>>();
    let count = likenesses.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| likenesses.iter().map(of).sum::<f64>() / count;
    let (music, dance) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        likenesses.iter().map(|pair| of(pair.0 - music, pair.1 - dance)).sum::<f64>()
    };
    let spread = (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    (spread > 0.0).then(|| sum(&|a, b| a * b) / spread)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use ndarray::Array2;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Frames of a bar: counts are twenty frames each.
    const BAR_FRAMES: usize = 80;

    /// A number for each bar of a form, a letter a bar.
    fn noise(form: &str, frame: usize, channel: usize) -> f64 {
        let letter = form.as_bytes()[(frame / BAR_FRAMES).min(form.len() - 1)];
        let seed = usize::from(letter) * 1_009 + frame % BAR_FRAMES / 20 * 131 + channel * 17;
        ((seed as f64 * 12.989_8).sin() * 43_758.547).fract()
    }

    fn song(form: &str) -> SongForm {
        let frames = form.len() * BAR_FRAMES;
        let rows = Array2::from_shape_fn((frames / 8, 438), |(row, column)| {
            noise(form, 8 * row, column) as f32
        });
        let beats: Vec<usize> = (0..frames).step_by(20).collect();
        SongForm::new(rows.view(), &beats).unwrap()
    }

    fn dance(form: &str) -> Vec<Pose> {
        let pose = |frame: usize| {
            std::array::from_fn(|joint| {
                let at = |axis| 0.1 * noise(form, frame, 1_000 + 3 * joint + axis);
                // The left is to the left, so that the dancer's frame stays.
                let side = [0.0, 1.0, -1.0][joint % 3];
                DVec3::new(side + at(0), at(1), at(2))
            })
        };
        (0..form.len() * BAR_FRAMES).map(pose).collect()
    }

    fn score(music: &str, moves: &str) -> Option<FormScore> {
        FormScore::new(&dance(moves), &song(music), &mut ChaCha8Rng::seed_from_u64(1))
    }

    #[test]
    fn a_dance_that_returns_with_the_music_agrees() {
        let form = "abcdefghabcdefgh";
        let same = score(form, form).unwrap();
        assert!(same.agreement > 0.5, "{same:?}");
        assert!(same.chance.abs() < 0.15, "{same:?}");
        let other = score(form, "abcdefghijklmnop").unwrap();
        assert!(other.agreement.abs() < 0.35, "{other:?}");
        let shifted = score(form, "abcdefabcdefabcd").unwrap();
        assert!(shifted.agreement < 0.2, "{shifted:?}");
    }

    #[test]
    fn a_few_bars_have_no_form() {
        assert_eq!(score("abcdefg", "abcdefg"), None);
        assert_eq!(score("abcdefghi", "abcdef"), None);
        assert!(SongForm::new(Array2::zeros((60, 438)).view(), &[]).is_none());
        // A dancer that stands still.
        let still = vec![[DVec3::ZERO; JOINTS]; 16 * BAR_FRAMES];
        let random = &mut ChaCha8Rng::seed_from_u64(1);
        assert_eq!(FormScore::new(&still, &song("abcdefghabcdefgh"), random), None);
    }
}
