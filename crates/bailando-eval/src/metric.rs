//! Every metric by name: one table for reports, JSON and plots.

use serde::{Serialize, Serializer, ser::SerializeMap};

/// The direction in which a metric improves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// Less is better.
    Low,
    /// More is better.
    High,
    /// The recordings' value is best.
    Alike,
}

/// Key in JSON, title in tables, wanted direction and decimals worth printing.
struct Row(&'static str, &'static str, Wanted, usize);

macro_rules! metrics {
    ($($doc:literal $name:ident $key:literal $title:literal $wanted:ident $decimals:literal)*) => {
        /// A metric of a set of motions.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Metric { $(#[doc = $doc] $name),* }

        const METRICS: [Metric; ROWS.len()] = [$(Metric::$name),*];
        const ROWS: &[Row] = &[$(Row($key, $title, Wanted::$wanted, $decimals)),*];
    };
}

metrics! {
    "Fréchet distance of kinetic features to the reference."
    FidK "fid_k" "FID_k" Low 3
    "Fréchet distance of geometric features to the reference."
    FidG "fid_g" "FID_g" Low 3
    "Mean distance of pairs in kinetic features."
    DivK "div_k" "Div_k" Alike 3
    "Mean distance of pairs in geometric features."
    DivG "div_g" "Div_g" Alike 3
    "Beat align score, Eq. 15: mean over music beats."
    BeatAlign "beat_align" "beat align score (Eq. 15)" High 4
    "The same with the music shifted at random."
    BeatChance "beat_chance" "its chance level" Alike 4
    "Beat align score less its chance level."
    BeatMargin "beat_margin" "margin over chance" High 4
    "Mean over dance beats: not comparable with Eq. 15."
    BeatAlignDance "beat_align_dance" "beat score over dance beats" High 4
    "Correlation of the likeness of two bars in the dance with that in the music."
    Form "form" "agreement of form with the music" High 4
    "The same with the dance's bars in random order."
    FormChance "form_chance" "its level for shuffled bars" Alike 4
    "Minima of the smoothed speed per second."
    DanceBeatsPerSecond "dance_beats_per_second" "dance beats per second" Alike 3
    "Share of frames slower than 0.15 m/s."
    SlowFrames "slow_frames" "share of frames below 0.15 m/s" Alike 4
    "Share of 5 s windows with at least a tenth of such frames."
    SluggishWindows "sluggish_windows" "share of 5 s windows with a tenth of such frames" Low 4
    "Share of such frames in the slowest 5 s window of all."
    SlowestWindow "slowest_window" "their share in the slowest 5 s window" Low 4
    "Mean joint speed, m/s."
    MeanSpeed "mean_speed" "mean joint speed, m/s" Alike 3
    "Mean length of the third derivative, m/s^3."
    Jerk "jerk" "jerk, m/s³" Alike 1
    "Horizontal speed of standing feet, cm/s."
    FootSkate "foot_skate" "foot skate, cm/s" Low 2
    "Physical foot contact score of EDGE: acceleration while both feet slide."
    FootContact "pfc" "physical foot contact (PFC)" Low 3
    "Lowest point of a sole in all motions, cm; of files with rotations, as those below."
    LowestFoot "lowest_foot" "lowest point of a foot, cm" High 2
    "Share of frames in which a forearm twists by more than 360 degrees a second."
    FastTwist "fast_twist" "share of forearms twisting beyond 360°/s" Low 4
    "Share of frames in which an elbow is bent beyond 150 degrees."
    FoldedElbows "folded_elbows" "share of elbows beyond 150°" Low 4
    "Share of frames in which a wrist is inside the head."
    WristInHead "wrist_in_head" "share of wrists inside the head" Low 4
    "Largest error of a joint when every other frame is interpolated, cm."
    HalfRateError "half_rate_error" "largest half-rate error, cm" Low 2
    "Largest change of a rotation channel from frame to frame, degrees."
    ChannelJump "channel_jump" "largest channel jump, degrees a frame" Low 1
    "Share of 2 s windows that a training take has, too."
    Recitation "recitation" "recited share of 2 s windows" Low 4
    "Share of 8 s windows that look like the style of their piece, or the one asked for."
    StyleAccuracy "style_accuracy" "share of 8 s windows whose style is recognised" High 3
    "Different codes of the upper body in all pieces."
    CodesUpper "codes_upper" "different codes, upper body" High 1
    "Different codes of the lower body in all pieces."
    CodesLower "codes_lower" "different codes, lower body" High 1
    "Entropy of the upper body's codes, bits."
    EntropyUpper "entropy_upper" "entropy of codes, upper body, bits" High 3
    "Entropy of the lower body's codes, bits."
    EntropyLower "entropy_lower" "entropy of codes, lower body, bits" High 3
}

impl Metric {
    /// Every metric, in the order of tables.
    pub fn all() -> impl Iterator<Item = Self> {
        METRICS.into_iter()
    }

    /// Its key in JSON.
    #[must_use]
    pub fn key(self) -> &'static str {
        ROWS[self as usize].0
    }

    /// Its name in tables.
    #[must_use]
    pub fn title(self) -> &'static str {
        ROWS[self as usize].1
    }

    pub(crate) fn wanted(self) -> Wanted {
        ROWS[self as usize].2
    }

    pub(crate) fn decimals(self) -> usize {
        ROWS[self as usize].3
    }
}

/// All metrics of one set of motions.
#[derive(Clone, Debug, PartialEq)]
pub struct Scores {
    /// Motions to a song.
    pub pieces: usize,
    /// Clips that distances and diversity were taken from.
    pub samples: usize,
    values: [Option<f64>; ROWS.len()],
}

impl Scores {
    pub(crate) fn new(pieces: usize, samples: usize) -> Self {
        Self { pieces, samples, values: [None; ROWS.len()] }
    }

    pub(crate) fn set(&mut self, metric: Metric, value: f64) {
        self.values[metric as usize] = Some(value);
    }

    /// None where it could not be measured: no beats, no training takes, no codes.
    #[must_use]
    pub fn get(&self, metric: Metric) -> Option<f64> {
        self.values[metric as usize]
    }
}

impl Serialize for Scores {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(ROWS.len() + 2))?;
        for metric in Metric::all() {
            map.serialize_entry(metric.key(), &self.get(metric))?;
        }
        map.serialize_entry("pieces", &self.pieces)?;
        map.serialize_entry("samples", &self.samples)?;
        map.end()
    }
}
