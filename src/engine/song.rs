//! A song as a generation needs it: what the model hears, and what callers are told of it.

use bytes::Bytes;
use ndarray::{Array2, Axis, Slice, concatenate};

use super::{
    EngineError, GenerationOptions, Progress, Stage,
    ears::{Ears, Heard},
    progress::spent,
    worker::LEAD_IN,
};
use crate::{
    CancelToken, Result,
    formats::{MusicInfo, Timings},
    model::Manifest,
};

/// What the model hears.
pub(super) struct Music {
    /// Feature rows `[rows, columns]`.
    pub(super) rows: Array2<f32>,
    /// Frames of the beats; none where nobody needs them.
    pub(super) beats: Vec<usize>,
}

impl Music {
    /// Refuses rows that a model of `columns` columns cannot hear.
    pub(super) fn new(
        rows: Array2<f32>,
        beats: Vec<usize>,
        columns: usize,
    ) -> Result<Self, EngineError> {
        let problem = if rows.ncols() != columns || rows.nrows() < 2 {
            format!(
                "expected at least 2 rows of {columns} columns, got {:?}",
                rows.dim()
            )
        } else if rows.iter().any(|value| !value.is_finite()) {
            "a value is not a finite number".into()
        } else {
            return Ok(Self { rows, beats });
        };
        Err(EngineError::Option {
            name: "features",
            problem,
        })
    }

    /// With a place in front for the code that leads in: it stands before the first row, which nobody hears
    /// (ARCHITECTURE 3).
    pub(super) fn led_in(mut self, frames_per_code: usize) -> Self {
        let first = self.rows.slice_axis(Axis(0), Slice::from(..LEAD_IN));
        // Both have the same columns.
        if let Ok(rows) = concatenate(Axis(0), &[first, self.rows.view()]) {
            self.rows = rows;
        }
        for beat in &mut self.beats {
            *beat += LEAD_IN * frames_per_code;
        }
        self
    }
}

/// A song that was listened to.
pub(super) struct Song {
    pub(super) music: Music,
    /// Tempo and beats, where they were asked for.
    pub(super) info: Option<MusicInfo>,
    pub(super) warnings: Vec<String>,
}

/// Listens to songs for the model of a manifest.
pub(super) struct Listening<'a> {
    pub(super) ears: &'a Ears,
    pub(super) manifest: &'a Manifest,
    pub(super) options: &'a GenerationOptions,
    /// Whether there will be candidates, which beats choose between.
    pub(super) has_a_choice: bool,
}

impl Listening<'_> {
    /// The song in `audio`.
    pub(super) fn song(
        &self,
        audio: Bytes,
        cancel: &CancelToken,
        progress: &dyn Progress,
        timings: &mut Timings,
    ) -> Result<Song> {
        let with_beats = self.options.music || self.has_a_choice;
        progress.stage(Stage::Decoding);
        let audio = spent(&mut timings.decode, "decode", || {
            let range = self.options.range;
            self.ears.decode(audio, range, with_beats, cancel)
        })?;
        progress.decoded(audio.duration_s);
        progress.stage(Stage::Features);
        let heard = spent(&mut timings.features, "features", || {
            self.ears.listen(audio.signals, with_beats, cancel)
        })?;
        self.told(heard, audio.warnings)
    }

    fn told(&self, heard: Heard, warnings: Vec<String>) -> Result<Song> {
        let fps = f64::from(self.manifest.fps);
        let beats = heard.beats.as_ref();
        let frames = beats
            .into_iter()
            .flat_map(|beats| beats.seconds())
            .map(|second| (second * fps).round() as usize)
            .collect();
        let info = beats.filter(|_| self.options.music);
        let info = info.map(|beats| MusicInfo {
            tempo_bpm: beats.tempo_bpm,
            beats_s: beats.seconds().collect(),
        });
        Ok(Song {
            music: Music::new(heard.rows, frames, self.manifest.features.columns)?,
            info,
            warnings,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_the_model_cannot_hear_are_refused() {
        let rows = |rows, columns, value| Array2::from_elem((rows, columns), value);
        for wrong in [
            rows(0, 3, 0.0),
            rows(1, 3, 0.0),
            rows(2, 4, 0.0),
            rows(2, 3, f32::NAN),
        ] {
            assert!(Music::new(wrong, Vec::new(), 3).is_err());
        }
        assert!(Music::new(rows(2, 3, 0.0), Vec::new(), 3).is_ok());
    }

    #[test]
    fn a_code_that_leads_in_moves_rows_and_beats_back() {
        let rows = Array2::from_shape_fn((3, 2), |(row, column)| (10 * row + column) as f32);
        let music = Music::new(rows.clone(), vec![0, 20], 2).unwrap();
        let led = music.led_in(8);
        assert_eq!(led.rows.nrows(), 4);
        assert_eq!(led.rows.row(0), rows.row(0));
        assert_eq!(led.rows.slice_axis(Axis(0), Slice::from(1..)), rows);
        assert_eq!(led.beats, [8, 28]);
    }
}
