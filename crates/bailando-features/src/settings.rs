//! What differs between rates and profiles, resolved once (FEATURES section 11).

use crate::{
    beat::BeatRules,
    cqt::CqtSettings,
    decimate::Decimation,
    layout::{Profile, Rate},
    padding::Padding,
};

/// Settings of every stage.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    pub(crate) sample_rate: f64,
    pub(crate) rows_per_second: f64,
    pub(crate) padding: Padding,
    /// Whether separation leaves the samples after the middle of the last frame silent.
    pub(crate) silent_tail: bool,
    pub(crate) onset_top_hz: f64,
    pub(crate) cqt: CqtSettings,
    pub(crate) beat_rules: BeatRules,
}

impl Settings {
    pub(crate) fn new(rate: Rate, profile: Profile) -> Self {
        let sample_rate = f64::from(rate.hz());
        let octaves = match rate {
            Rate::Conditioning => 5,
            Rate::Beats => 7,
        };
        // Ratio of neighbouring bins, and of bins two apart.
        let (one_bin, two_bins) = ((1.0_f64 / 36.0).exp2(), (1.0_f64 / 18.0).exp2());
        let (padding, quality, decimation) = match profile {
            Profile::Librosa011 => {
                (Padding::Zeros, (two_bins + 1.0) / (two_bins - 1.0), Decimation::SoxrHq)
            }
            Profile::Librosa081 => {
                (Padding::Reflect, 1.0 / (one_bin - 1.0), Decimation::KaiserFast)
            }
        };
        Self {
            sample_rate,
            rows_per_second: rate.rows_per_second(),
            padding,
            silent_tail: profile == Profile::Librosa081,
            onset_top_hz: match profile {
                Profile::Librosa011 => sample_rate / 2.0,
                // At every rate: at 3,840 Hz most bands stay empty and the envelope with them.
                Profile::Librosa081 => 11_025.0,
            },
            cqt: CqtSettings { sample_rate, octaves, quality, decimation, padding },
            beat_rules: match profile {
                Profile::Librosa011 => BeatRules::Current,
                Profile::Librosa081 => BeatRules::Librosa081,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn qualities_are_those_of_the_specification() {
        let quality = |profile| Settings::new(Rate::Beats, profile).cqt.quality;
        assert!((quality(Profile::Librosa011) - 51.94).abs() < 0.01);
        assert!((quality(Profile::Librosa081) - 51.44).abs() < 0.01);
    }
}
