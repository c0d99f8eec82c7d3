//! All metrics of one set of motions.

use std::collections::BTreeMap;

use ndarray::Array2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::{
    beats::{BeatScore, speed},
    body::Motion,
    clips::Clips,
    distance::{Standard, diversity, frechet_distance},
    error::EvaluationError,
    form::FormScore,
    geometric::{GEOMETRIC_FEATURES, geometric_features},
    kinetic::{KINETIC_FEATURES, KineticForm, kinetic_features},
    metric::{Metric, Scores},
    motion_quality::MotionQuality,
    music::{MusicBeats, SongForms},
    recitation::TrainingTakes,
    sets::MotionSet,
    skeletal::SkeletalQuality,
    style::StyleRecognition,
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
    /// Computes the features of all clips of some motions. Values have the precision of float32, as
    /// published ones were stored.
    #[must_use]
    pub fn new<'a>(
        motions: impl IntoIterator<Item = &'a Motion>,
        clips: Clips,
        form: KineticForm,
    ) -> Self {
        let (mut kinetic, mut geometric) = (Vec::new(), Vec::new());
        for clip in motions.into_iter().flat_map(|motion| clips.of(motion)) {
            kinetic.extend(kinetic_features(&clip, form).map(stored));
            geometric.extend(geometric_features(&clip).map(stored));
        }
        Self {
            kinetic: rows(&kinetic, KINETIC_FEATURES),
            geometric: rows(&geometric, GEOMETRIC_FEATURES),
        }
    }

    fn samples(&self) -> usize {
        self.kinetic.nrows()
    }
}

fn stored(value: f64) -> f64 {
    f64::from(value as f32)
}

fn rows(values: &[f64], columns: usize) -> Array2<f64> {
    let cell = |(row, column)| values[row * columns + column];
    Array2::from_shape_fn((values.len() / columns, columns), cell)
}

/// The reference set in its own units.
#[derive(Clone, Debug)]
pub(crate) struct ReferenceSpace {
    clips: Clips,
    form: KineticForm,
    kinetic: (Standard, Array2<f64>),
    geometric: (Standard, Array2<f64>),
}

impl ReferenceSpace {
    /// Measures all reference motions.
    ///
    /// # Errors
    /// [`EvaluationError::TooFew`] with fewer than two clips.
    pub(crate) fn new<'a>(
        reference: impl IntoIterator<Item = &'a Motion>,
        clips: Clips,
        form: KineticForm,
    ) -> Result<Self, EvaluationError> {
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

    /// Number of clips of the reference.
    pub(crate) fn samples(&self) -> usize {
        self.kinetic.1.nrows()
    }

    /// Kinetic and geometric columns that are left out because they are constant in the reference.
    pub(crate) fn constant_columns(&self) -> [Vec<usize>; 2] {
        [&self.kinetic.0, &self.geometric.0].map(|standard| standard.constant_columns().to_vec())
    }

    /// Measures Fréchet distances and diversity of a set.
    fn measure(&self, name: &str, set: &MotionSet) -> Result<Scores, EvaluationError> {
        let features = FeatureRows::new(set.motions(), self.clips, self.form);
        enough(name, self.clips, features.samples())?;
        let mut scores = Scores::new(set.pieces.len(), features.samples());
        for ((standard, reference), rows, fid, div) in [
            (&self.kinetic, features.kinetic, Metric::FidK, Metric::DivK),
            (&self.geometric, features.geometric, Metric::FidG, Metric::DivG),
        ] {
            let rows = standard.apply(rows.view());
            scores.set(fid, frechet_distance(rows.view(), reference.view()));
            scores.set(div, diversity(rows.view()));
        }
        Ok(scores)
    }
}

fn enough(set: &str, clips: Clips, got: usize) -> Result<(), EvaluationError> {
    if got < 2 {
        return Err(EvaluationError::TooFew { set: set.to_owned(), samples: clips.noun(), got });
    }
    Ok(())
}

/// Measures sets against one reference.
#[derive(Debug)]
pub(crate) struct Evaluator {
    /// For distances.
    pub(crate) reference: ReferenceSpace,
    /// For beat scores; none: they are left out.
    pub(crate) beats: Option<MusicBeats>,
    /// For the agreement of forms; none: it is left out.
    pub(crate) forms: Option<SongForms>,
    /// For recitation; none: it is left out.
    pub(crate) takes: Option<TrainingTakes>,
    /// For the recognition of styles; none: it is left out.
    pub(crate) styles: Option<StyleRecognition>,
    /// Seed of the random shifts and orders behind chance levels.
    pub(crate) seed: u64,
}

impl Evaluator {
    /// Computes what a few pieces are enough for, for each style of a set.
    pub(crate) fn score_by_style(&self, set: &MotionSet) -> BTreeMap<String, Scores> {
        let styles = set.by_style().into_iter();
        let score = |set: &MotionSet| {
            let mut scores = Scores::new(set.pieces.len(), 0);
            score_quality(&mut scores, &set.motions());
            self.score_songs(&mut scores, set);
            scores
        };
        styles.map(|(style, set)| (style.to_owned(), score(&set))).collect()
    }

    /// Scores pieces by what is known of their songs: beats, form and styles.
    fn score_songs(&self, scores: &mut Scores, set: &MotionSet) {
        if let Some(beats) = &self.beats {
            score_beats(scores, set, beats, self.seed);
        }
        if let Some(forms) = &self.forms {
            score_forms(scores, set, forms, self.seed);
        }
        if let Some(styles) = &self.styles {
            score_styles(scores, set, styles);
        }
    }

    /// Computes all metrics of a set; `name` is for errors.
    ///
    /// # Errors
    /// [`EvaluationError::TooFew`] if the set has fewer than two clips.
    pub(crate) fn score(&self, name: &str, set: &MotionSet) -> Result<Scores, EvaluationError> {
        let mut scores = self.reference.measure(name, set)?;
        let motions = set.motions();
        score_quality(&mut scores, &motions);
        score_rotations(&mut scores, &motions);
        self.score_songs(&mut scores, set);
        if let Some(takes) = &self.takes {
            let counts = motions.iter().map(|motion| takes.recited(motion.poses()));
            let (recited, all) = counts.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            if all > 0 {
                scores.set(Metric::Recitation, recited as f64 / all as f64);
            }
        }
        score_codes(&mut scores, &motions);
        Ok(scores)
    }
}

fn score_quality(scores: &mut Scores, motions: &[&Motion]) {
    let each: Vec<MotionQuality> =
        motions.iter().map(|motion| MotionQuality::new(motion.poses())).collect();
    let means: [Mean<MotionQuality>; 6] = [
        (Metric::DanceBeatsPerSecond, |q| Some(q.dance_beats_per_second)),
        (Metric::SlowFrames, |q| Some(q.slow_frames)),
        (Metric::MeanSpeed, |q| Some(q.mean_speed)),
        (Metric::Jerk, |q| Some(q.jerk)),
        (Metric::FootSkate, |q| Some(q.foot_skate)),
        (Metric::FootContact, |q| q.physical_foot_contact),
    ];
    set_means(scores, &each, &means);
    let windows: usize = each.iter().map(|quality| quality.windows).sum();
    let sluggish: usize = each.iter().map(|quality| quality.sluggish_windows).sum();
    if windows > 0 {
        scores.set(Metric::SluggishWindows, sluggish as f64 / windows as f64);
        let slowest = each.iter().map(|quality| quality.slowest_window);
        scores.set(Metric::SlowestWindow, slowest.fold(0.0, f64::max));
    }
}

/// Scores rotations where every motion has them.
fn score_rotations(scores: &mut Scores, motions: &[&Motion]) {
    let each = motions.iter().map(|motion| motion.skeletal().map(SkeletalQuality::new));
    let Some(each) = each.collect::<Option<Vec<_>>>() else {
        return;
    };
    let means: [Mean<SkeletalQuality>; 3] = [
        (Metric::FastTwist, |q| Some(q.fast_twist)),
        (Metric::FoldedElbows, |q| Some(q.folded_elbows)),
        (Metric::WristInHead, |q| Some(q.wrist_in_head)),
    ];
    set_means(scores, &each, &means);
    let worst = |value: fn(&SkeletalQuality) -> f64| each.iter().map(value).reduce(f64::max);
    for (metric, worst) in [
        (Metric::LowestFoot, worst(|q| -q.lowest_foot).map(|depth| -depth)),
        (Metric::HalfRateError, worst(|q| q.half_rate_error)),
        (Metric::ChannelJump, worst(|q| q.channel_jump)),
    ] {
        worst.into_iter().for_each(|value| scores.set(metric, value));
    }
}

fn score_beats(scores: &mut Scores, set: &MotionSet, beats: &MusicBeats, seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let scored = set.pieces.iter().filter_map(|piece| {
        let poses = piece.motion.poses();
        let dance = dance_beats(&speed(poses));
        BeatScore::new(poses.len(), beats.of(&piece.id), &dance, &mut random)
    });
    let each: Vec<BeatScore> = scored.collect();
    let means: [Mean<BeatScore>; 4] = [
        (Metric::BeatAlign, |score| Some(score.align)),
        (Metric::BeatAlignDance, |score| Some(score.align_dance)),
        (Metric::BeatChance, |score| score.chance),
        (Metric::BeatMargin, |score| Some(score.align - score.chance?)),
    ];
    set_means(scores, &each, &means);
}

fn score_forms(scores: &mut Scores, set: &MotionSet, forms: &SongForms, seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let scored = set.pieces.iter().filter_map(|piece| {
        FormScore::new(piece.motion.poses(), forms.of(&piece.id)?, &mut random)
    });
    let each: Vec<FormScore> = scored.collect();
    let means: [Mean<FormScore>; 2] = [
        (Metric::Form, |score| Some(score.agreement)),
        (Metric::FormChance, |score| Some(score.chance)),
    ];
    set_means(scores, &each, &means);
}

fn score_styles(scores: &mut Scores, set: &MotionSet, styles: &StyleRecognition) {
    let counts = set
        .pieces
        .iter()
        .filter_map(|piece| styles.recognised(piece.style.as_deref()?, piece.motion.poses()));
    let (recognised, all) = counts.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    if all > 0 {
        scores.set(Metric::StyleAccuracy, recognised as f64 / all as f64);
    }
}

/// A metric that is the mean of a value of each motion or piece; none has no part in it.
type Mean<T> = (Metric, fn(&T) -> Option<f64>);

fn set_means<T>(scores: &mut Scores, each: &[T], means: &[Mean<T>]) {
    for &(metric, value) in means {
        let values = each.iter().filter_map(value);
        let sum_and_count = values.fold((0.0, 0_u32), |(sum, count), v| (sum + v, count + 1));
        if let (sum, count @ 1..) = sum_and_count {
            scores.set(metric, sum / f64::from(count));
        }
    }
}

/// Scores codes where every motion has them.
fn score_codes(scores: &mut Scores, motions: &[&Motion]) {
    let halves =
        [(Metric::CodesUpper, Metric::EntropyUpper), (Metric::CodesLower, Metric::EntropyLower)];
    for (half, (different, entropy)) in halves.into_iter().enumerate() {
        let mut counts: BTreeMap<u32, u32> = BTreeMap::new();
        for motion in motions {
            let codes = motion.codes().map(|codes| &codes[half]);
            let Some(codes) = codes.filter(|codes| !codes.is_empty()) else {
                return;
            };
            for &code in codes {
                *counts.entry(code).or_default() += 1;
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

    /// Scores motions against some reference motions.
    fn score(reference: &[Motion], motions: Vec<Motion>) -> Result<Scores, EvaluationError> {
        let (clips, form) = (Clips::default(), KineticForm::Published);
        let evaluator = Evaluator {
            reference: ReferenceSpace::new(reference, clips, form)?,
            beats: None,
            forms: None,
            takes: Some(TrainingTakes::new(reference)),
            styles: None,
            seed: 0,
        };
        evaluator.score("generated", &MotionSet::from_motions(motions))
    }

    #[test]
    fn a_set_is_at_no_distance_from_itself_and_recites_itself() {
        let motions = [2.0, 3.0, 4.0, 5.5].map(|pace| motion("own", pace));
        let scores = score(&motions, motions.to_vec()).unwrap();
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
        let motions = [with([vec![1, 1, 2], vec![5, 5, 5]], 2.0), with([vec![2], vec![5]], 3.0)];
        let scores = score(&motions, motions.to_vec()).unwrap();
        for (metric, expected) in [
            (Metric::CodesUpper, 2.0),
            (Metric::EntropyUpper, 1.0),
            (Metric::CodesLower, 1.0),
            (Metric::EntropyLower, 0.0),
        ] {
            assert_eq!(scores.get(metric), Some(expected), "{metric:?}");
        }
    }

    #[test]
    fn one_sample_is_too_few() {
        let motions = [motion("a", 2.0), motion("b", 3.0)];
        let error = score(&motions[..1], motions.to_vec());
        assert!(matches!(error, Err(EvaluationError::TooFew { got: 1, .. })));
        let error = score(&motions, motions[..1].to_vec()).unwrap_err();
        assert!(error.to_string().contains("generated: 1 motions"), "{error}");
    }
}
