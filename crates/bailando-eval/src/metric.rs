//! Every metric by name: one table for tables, JSON and plots.

use serde::{Serialize, Serializer, ser::SerializeMap};

/// What is measured on a set of dances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Metric {
    /// Fréchet distance of kinetic features to the reference.
    FidK,
    /// Fréchet distance of geometric features to the reference.
    FidG,
    /// Mean distance of pairs in kinetic features.
    DivK,
    /// Mean distance of pairs in geometric features.
    DivG,
    /// Beat align score, Eq. 15: mean over music beats.
    BeatAlign,
    /// The same with the music shifted at random.
    BeatChance,
    /// Beat align score less its chance level.
    BeatMargin,
    /// Mean over dance beats: not comparable with Eq. 15.
    BeatAlignDance,
    /// Minima of the smoothed speed per second.
    DanceBeatsPerSecond,
    /// Share of frames slower than 0.15 m/s.
    SlowFrames,
    /// Share of 5 s windows with at least a tenth of such frames.
    SluggishWindows,
    /// Share of such frames in the slowest 5 s window of all.
    SlowestWindow,
    /// Mean joint speed, m/s.
    MeanSpeed,
    /// Mean length of the third derivative, m/s^3.
    Jerk,
    /// Horizontal speed of standing feet, cm/s.
    FootSkate,
    /// Share of 2 s windows that a training take has, too.
    Recitation,
    /// Different codes of the upper body in all pieces.
    CodesUpper,
    /// Different codes of the lower body in all pieces.
    CodesLower,
    /// Entropy of the upper body's codes, bits.
    EntropyUpper,
    /// Entropy of the lower body's codes, bits.
    EntropyLower,
}

/// What good is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Less is better.
    Low,
    /// More is better.
    High,
    /// As the recordings.
    Alike,
}

/// Key, title, wanted direction and decimals.
struct Row(Metric, &'static str, &'static str, Wanted, usize);

const ROWS: [Row; 20] = [
    Row(Metric::FidK, "fid_k", "FID_k", Wanted::Low, 3),
    Row(Metric::FidG, "fid_g", "FID_g", Wanted::Low, 3),
    Row(Metric::DivK, "div_k", "Div_k", Wanted::Alike, 3),
    Row(Metric::DivG, "div_g", "Div_g", Wanted::Alike, 3),
    Row(
        Metric::BeatAlign,
        "beat_align",
        "beat align score (Eq. 15)",
        Wanted::High,
        4,
    ),
    Row(
        Metric::BeatChance,
        "beat_chance",
        "its chance level",
        Wanted::Alike,
        4,
    ),
    Row(
        Metric::BeatMargin,
        "beat_margin",
        "margin over chance",
        Wanted::High,
        4,
    ),
    Row(
        Metric::BeatAlignDance,
        "beat_align_dance",
        "beat score over dance beats",
        Wanted::High,
        4,
    ),
    Row(
        Metric::DanceBeatsPerSecond,
        "dance_beats_per_second",
        "dance beats per second",
        Wanted::Alike,
        3,
    ),
    Row(
        Metric::SlowFrames,
        "slow_frames",
        "share of frames below 0.15 m/s",
        Wanted::Alike,
        4,
    ),
    Row(
        Metric::SluggishWindows,
        "sluggish_windows",
        "share of 5 s windows with a tenth of such frames",
        Wanted::Low,
        4,
    ),
    Row(
        Metric::SlowestWindow,
        "slowest_window",
        "their share in the slowest 5 s window",
        Wanted::Low,
        4,
    ),
    Row(
        Metric::MeanSpeed,
        "mean_speed",
        "mean joint speed, m/s",
        Wanted::Alike,
        3,
    ),
    Row(Metric::Jerk, "jerk", "jerk, m/s³", Wanted::Alike, 1),
    Row(
        Metric::FootSkate,
        "foot_skate",
        "foot skate, cm/s",
        Wanted::Low,
        2,
    ),
    Row(
        Metric::Recitation,
        "recitation",
        "recited share of 2 s windows",
        Wanted::Low,
        4,
    ),
    Row(
        Metric::CodesUpper,
        "codes_upper",
        "different codes, upper body",
        Wanted::High,
        1,
    ),
    Row(
        Metric::CodesLower,
        "codes_lower",
        "different codes, lower body",
        Wanted::High,
        1,
    ),
    Row(
        Metric::EntropyUpper,
        "entropy_upper",
        "entropy of codes, upper body, bits",
        Wanted::High,
        3,
    ),
    Row(
        Metric::EntropyLower,
        "entropy_lower",
        "entropy of codes, lower body, bits",
        Wanted::High,
        3,
    ),
];

impl Metric {
    /// Every metric, in the order of tables.
    pub fn all() -> impl Iterator<Item = Self> {
        ROWS.iter().map(|row| row.0)
    }

    fn row(self) -> &'static Row {
        // Rows stand in the order of the cases; a test holds them to it.
        &ROWS[self as usize]
    }

    /// Its key in JSON.
    #[must_use]
    pub fn key(self) -> &'static str {
        self.row().1
    }

    /// Its name in tables.
    #[must_use]
    pub fn title(self) -> &'static str {
        self.row().2
    }

    /// What good is.
    #[must_use]
    pub fn wanted(self) -> Wanted {
        self.row().3
    }

    /// Decimals worth printing.
    #[must_use]
    pub fn decimals(self) -> usize {
        self.row().4
    }
}

/// What was measured on one set of dances.
#[derive(Clone, Debug, PartialEq)]
pub struct Scores {
    /// Dances to a song.
    pub pieces: usize,
    /// Clips that distances and diversity were taken from.
    pub samples: usize,
    values: [Option<f64>; ROWS.len()],
}

impl Scores {
    pub(super) fn new(pieces: usize, samples: usize) -> Self {
        Self {
            pieces,
            samples,
            values: [None; ROWS.len()],
        }
    }

    pub(super) fn set(&mut self, metric: Metric, value: f64) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_stand_in_the_order_of_the_cases() {
        for (at, row) in ROWS.iter().enumerate() {
            assert_eq!(row.0 as usize, at, "{}", row.1);
        }
    }
}
