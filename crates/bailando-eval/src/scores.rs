//! All metrics of one set of dances.

use std::collections::BTreeMap;

use ndarray::Array2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{
    EvaluationError, Motion,
    beats::{BeatScore, speed},
    clips::Clips,
    distance::{Standard, diversity, frechet_distance},
    geometric::{GEOMETRIC_FEATURES, geometric_features},
    kinetic::{KINETIC_FEATURES, KineticForm, kinetic_features},
    metric::{Metric, Scores},
    motion_quality::MotionQuality,
    music::MusicBeats,
    recitation::Repertoire,
    reference::DanceSet,
};
use bailando_motion::dance_beats;

/// Feature rows of a set's clips.
#[derive(Clone, Debug)]
pub struct FeatureRows {
    /// `[clips, 72]`.
    pub kinetic: Array2<f64>,
    /// `[clips, 32]`.
    pub geometric: Array2<f64>,
}

impl FeatureRows {
    /// Of all clips of some motions. Values have the precision of float32, as published ones were
    /// stored.
    #[must_use]
    pub fn new(motions: &[Motion], clips: Clips, form: KineticForm) -> Self {
        let (mut kinetic, mut geometric) = (Vec::new(), Vec::new());
        for clip in motions.iter().flat_map(|motion| clips.of(motion)) {
            kinetic.extend(kinetic_features(&clip, form).map(stored));
            geometric.extend(geometric_features(&clip).map(stored));
        }
        Self {
            kinetic: rows(kinetic, KINETIC_FEATURES),
            geometric: rows(geometric, GEOMETRIC_FEATURES),
        }
    }

    /// Clips that the rows come from.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.kinetic.nrows()
    }
}

fn stored(value: f64) -> f64 {
    f64::from(value as f32)
}

fn rows(values: Vec<f64>, columns: usize) -> Array2<f64> {
    let rows = values.len() / columns;
    Array2::from_shape_fn((rows, columns), |(row, column)| {
        values[row * columns + column]
    })
}

/// The reference set in its own units.
#[derive(Clone, Debug)]
pub struct Ruler {
    clips: Clips,
    form: KineticForm,
    kinetic: (Standard, Array2<f64>),
    geometric: (Standard, Array2<f64>),
}

impl Ruler {
    /// A ruler made of all reference motions.
    ///
    /// # Errors
    /// [`EvaluationError::TooFew`] with fewer than two clips, [`EvaluationError::Option`] for
    /// senseless ones.
    pub fn new(
        reference: &[Motion],
        clips: Clips,
        form: KineticForm,
    ) -> Result<Self, EvaluationError> {
        clips.check()?;
        let features = FeatureRows::new(reference, clips, form);
        enough("the reference", clips, features.samples())?;
        let standard = |rows: &Array2<f64>| {
            let standard = Standard::new(rows.view());
            let rows = standard.apply(rows.view());
            (standard, rows)
        };
        Ok(Self {
            clips,
            form,
            kinetic: standard(&features.kinetic),
            geometric: standard(&features.geometric),
        })
    }

    /// Clips of the reference.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.kinetic.1.nrows()
    }

    /// Kinetic and geometric columns that are left out because they are constant in the reference.
    #[must_use]
    pub fn constant_columns(&self) -> [&[usize]; 2] {
        [&self.kinetic.0, &self.geometric.0].map(Standard::constant_columns)
    }

    /// Fréchet distances and diversity of a set.
    fn measure(&self, name: &str, set: &DanceSet) -> Result<Scores, EvaluationError> {
        let features = FeatureRows::new(&set.motions, self.clips, self.form);
        enough(name, self.clips, features.samples())?;
        let mut scores = Scores::new(set.pieces.len(), features.samples());
        let sides = [
            (&self.kinetic, &features.kinetic, Metric::FidK, Metric::DivK),
            (
                &self.geometric,
                &features.geometric,
                Metric::FidG,
                Metric::DivG,
            ),
        ];
        for ((standard, reference), rows, fid, div) in sides {
            let rows = standard.apply(rows.view());
            scores.set(fid, frechet_distance(rows.view(), reference.view()));
            scores.set(div, diversity(rows.view()));
        }
        Ok(scores)
    }
}

fn enough(set: &str, clips: Clips, got: usize) -> Result<(), EvaluationError> {
    if got < 2 {
        return Err(EvaluationError::TooFew {
            set: set.to_owned(),
            samples: clips.noun(),
            got,
        });
    }
    Ok(())
}

/// Everything that a set is measured with.
#[derive(Debug)]
pub struct Judge {
    /// For distances.
    pub ruler: Ruler,
    /// For beat scores; none: they are left out.
    pub beats: Option<MusicBeats>,
    /// For recitation; none: it is left out.
    pub repertoire: Option<Repertoire>,
    /// Seed of the random shifts behind the chance level.
    pub seed: u64,
}

impl Judge {
    /// All metrics of a set; `name` is for errors.
    ///
    /// # Errors
    /// [`EvaluationError::TooFew`] if the set has fewer than two clips.
    pub fn score(&self, name: &str, set: &DanceSet) -> Result<Scores, EvaluationError> {
        let mut scores = self.ruler.measure(name, set)?;
        score_quality(&mut scores, &set.motions);
        if let Some(beats) = &self.beats {
            score_beats(&mut scores, set, beats, self.seed);
        }
        if let Some(repertoire) = &self.repertoire {
            let counts = set
                .motions
                .iter()
                .map(|motion| repertoire.recited(motion.poses()));
            let (recited, all) = counts.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            if all > 0 {
                scores.set(Metric::Recitation, recited as f64 / all as f64);
            }
        }
        score_codes(&mut scores, &set.motions);
        Ok(scores)
    }
}

fn score_quality(scores: &mut Scores, motions: &[Motion]) {
    let each: Vec<MotionQuality> = motions
        .iter()
        .map(|motion| MotionQuality::new(motion.poses()))
        .collect();
    let mut mean = |metric, field: fn(&MotionQuality) -> f64| {
        set_mean(scores, metric, each.iter().map(field));
    };
    mean(Metric::DanceBeatsPerSecond, |q| q.dance_beats_per_second);
    mean(Metric::SlowFrames, |q| q.slow_frames);
    mean(Metric::MeanSpeed, |q| q.mean_speed);
    mean(Metric::Jerk, |q| q.jerk);
    mean(Metric::FootSkate, |q| q.foot_skate);
    score_freezing(scores, &each);
}

fn score_freezing(scores: &mut Scores, each: &[MotionQuality]) {
    let windows: usize = each.iter().map(|quality| quality.windows).sum();
    let sluggish: usize = each.iter().map(|quality| quality.sluggish_windows).sum();
    if windows > 0 {
        scores.set(Metric::SluggishWindows, sluggish as f64 / windows as f64);
        let slowest = each.iter().map(|quality| quality.slowest_window);
        scores.set(Metric::SlowestWindow, slowest.fold(0.0, f64::max));
    }
}

fn score_beats(scores: &mut Scores, set: &DanceSet, beats: &MusicBeats, seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let dances: Vec<Vec<usize>> = set
        .motions
        .iter()
        .map(|motion| dance_beats(&speed(motion.poses())))
        .collect();
    let each: Vec<BeatScore> = set
        .pieces
        .iter()
        .filter_map(|piece| {
            let frames = set.motions.get(piece.motion)?.poses().len();
            BeatScore::new(
                frames,
                beats.of(&piece.id),
                dances.get(piece.motion)?,
                &mut random,
            )
        })
        .collect();
    set_mean(
        scores,
        Metric::BeatAlign,
        each.iter().map(|score| score.align),
    );
    set_mean(
        scores,
        Metric::BeatAlignDance,
        each.iter().map(|score| score.align_dance),
    );
    set_mean(
        scores,
        Metric::BeatChance,
        each.iter().filter_map(|score| score.chance),
    );
    let margin = |score: &BeatScore| Some(score.align - score.chance?);
    set_mean(scores, Metric::BeatMargin, each.iter().filter_map(margin));
}

fn set_mean(scores: &mut Scores, metric: Metric, values: impl Iterator<Item = f64>) {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    if count > 0 {
        scores.set(metric, sum / f64::from(count));
    }
}

/// Only where every motion tells its codes.
fn score_codes(scores: &mut Scores, motions: &[Motion]) {
    let halves = [
        (Metric::CodesUpper, Metric::EntropyUpper),
        (Metric::CodesLower, Metric::EntropyLower),
    ];
    for (half, (different, entropy)) in halves.into_iter().enumerate() {
        let mut counts: BTreeMap<u32, u32> = BTreeMap::new();
        for motion in motions {
            match motion.codes() {
                Some(codes) if !codes[half].is_empty() => {
                    for &code in &codes[half] {
                        *counts.entry(code).or_default() += 1;
                    }
                }
                _ => return,
            }
        }
        let total = f64::from(counts.values().sum::<u32>());
        let bits = counts.values().map(|&count| {
            let share = f64::from(count) / total;
            -share * share.log2()
        });
        scores.set(different, counts.len() as f64);
        scores.set(entropy, bits.sum());
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    fn motion(name: &str, pace: f32) -> Motion {
        let positions = Array3::from_shape_fn((400, 24, 3), |(frame, joint, axis)| {
            let t = frame as f32 / 60.0;
            let phase = joint as f32 * 0.7 + axis as f32 * 1.3;
            (pace * t + phase).sin() * 0.3 + phase.cos()
        });
        Motion::new(name, positions.view()).unwrap()
    }

    fn judge(motions: &[Motion]) -> Judge {
        Judge {
            ruler: Ruler::new(motions, Clips::default(), KineticForm::Published).unwrap(),
            beats: None,
            repertoire: Some(Repertoire::new(motions)),
            seed: 0,
        }
    }

    #[test]
    fn a_set_is_at_no_distance_from_itself_and_recites_itself() {
        let motions: Vec<Motion> = [2.0, 3.0, 4.0, 5.5]
            .iter()
            .map(|&pace| motion("own", pace))
            .collect();
        let judge = judge(&motions);
        let scores = judge
            .score("own", &DanceSet::from_motions(motions))
            .unwrap();
        // 72 roots of rounding errors.
        assert!(scores.get(Metric::FidK).unwrap().abs() < 1e-3);
        assert!(scores.get(Metric::FidG).unwrap().abs() < 1e-3);
        assert_eq!(scores.get(Metric::Recitation), Some(1.0));
        assert_eq!(scores.get(Metric::BeatAlign), None);
        assert_eq!(scores.get(Metric::CodesUpper), None);
        assert_eq!((scores.pieces, scores.samples), (4, 4));
    }

    #[test]
    fn codes_are_counted_over_all_pieces() {
        let with = |codes: [Vec<u32>; 2], pace| motion("coded", pace).with_codes(codes);
        let motions = vec![
            with([vec![1, 1, 2], vec![5, 5, 5]], 2.0),
            with([vec![2], vec![5]], 3.0),
        ];
        let scores = judge(&motions)
            .score("own", &DanceSet::from_motions(motions))
            .unwrap();
        assert_eq!(scores.get(Metric::CodesUpper), Some(2.0));
        assert_eq!(scores.get(Metric::EntropyUpper), Some(1.0));
        assert_eq!(scores.get(Metric::CodesLower), Some(1.0));
        assert_eq!(scores.get(Metric::EntropyLower), Some(0.0));
    }

    #[test]
    fn one_sample_is_too_few() {
        let motions = [motion("a", 2.0), motion("b", 3.0)];
        let error = Ruler::new(&motions[..1], Clips::default(), KineticForm::Published);
        assert!(matches!(error, Err(EvaluationError::TooFew { got: 1, .. })));
        let one = DanceSet::from_motions(vec![motions[0].clone()]);
        let error = judge(&motions)
            .score("generated", &one)
            .unwrap_err()
            .to_string();
        assert!(error.contains("generated: 1 motions"), "{error}");
    }
}
