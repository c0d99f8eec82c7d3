//! The music as the model is conditioned on it.

use ndarray::{Array2, Axis, Slice, concatenate};

use super::{EngineError, form::Form};
use crate::{features::Rate, formats::MusicInfo};

/// Codes of an earlier motion that are given as the first ones of a motion that continues it.
pub(super) const PROMPT_CODES: usize = 1;

/// The music as the model is conditioned on it.
#[derive(Clone, Debug)]
pub(crate) struct Conditioning {
    /// Feature rows `[rows, columns]`, one per code.
    pub(crate) features: Array2<f32>,
    /// Frames of the beats, ascending; none where they are not known.
    pub(crate) beats: Vec<usize>,
    /// What returns in the song; nothing where it is not wanted, or not known.
    pub(crate) form: Form,
    /// Tempo, beats and bars for the caller, where they are wanted.
    pub(crate) music: Option<MusicInfo>,
    /// Seconds of audio that are danced to; none for feature rows.
    pub(crate) seconds: Option<f64>,
    /// What was trimmed, truncated or assumed about the audio.
    pub(crate) warnings: Vec<String>,
}

impl Conditioning {
    /// Refuses rows that a model of `columns` columns cannot be conditioned on. `beats` are motion
    /// frames.
    pub(crate) fn new(
        features: Array2<f32>,
        beats: Vec<usize>,
        columns: usize,
    ) -> Result<Self, EngineError> {
        let problem = if features.ncols() != columns || features.nrows() < 2 {
            format!("expected at least 2 rows of {columns} columns, got {:?}", features.dim())
        } else if features.iter().any(|value| !value.is_finite()) {
            "a value is not a finite number".into()
        } else {
            return Ok(Self {
                features,
                beats,
                form: Form::default(),
                music: None,
                seconds: None,
                warnings: Vec::new(),
            });
        };
        Err(EngineError::Option { name: "features", problem })
    }

    /// Takes what the caller is told of the music, with time from the frame `lead` on, which is
    /// where the motion begins: the frames before it belong to the motion that it continues.
    pub(crate) fn take_music_from(&mut self, lead: usize) -> Option<MusicInfo> {
        let mut info = self.music.take()?;
        let lead_s = lead as f64 / Rate::Beats.rows_per_second();
        for times in [&mut info.beats_s, &mut info.downbeats_s] {
            times.retain_mut(|time| {
                *time -= lead_s;
                *time >= 0.0
            });
        }
        Some(info)
    }

    /// Makes room for the prompt: its code stands before the first row, which the model is never
    /// conditioned on (ARCHITECTURE 3).
    pub(crate) fn after_prompt(mut self, frames_per_code: usize) -> Self {
        let first = self.features.slice_axis(Axis(0), Slice::from(..PROMPT_CODES));
        self.features = concatenate(Axis(0), &[first, self.features.view()])
            .unwrap_or_else(|_| unreachable!("both have the same columns"));
        self.form.after(PROMPT_CODES);
        for beat in &mut self.beats {
            *beat += PROMPT_CODES * frames_per_code;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_do_not_fit_the_model_are_refused() {
        let rows = |rows, columns, value| Array2::from_elem((rows, columns), value);
        for wrong in [rows(0, 3, 0.0), rows(1, 3, 0.0), rows(2, 4, 0.0), rows(2, 3, f32::NAN)] {
            assert!(Conditioning::new(wrong, Vec::new(), 3).is_err());
        }
        assert!(Conditioning::new(rows(2, 3, 0.0), Vec::new(), 3).is_ok());
    }

    #[test]
    fn a_prompt_moves_rows_and_beats_back() {
        let rows = Array2::from_shape_fn((3, 2), |(row, column)| (10 * row + column) as f32);
        let conditioning = Conditioning::new(rows.clone(), vec![0, 30], 2).unwrap();
        let after = conditioning.after_prompt(8);
        assert_eq!(after.features.nrows(), 4);
        assert_eq!(after.features.row(0), rows.row(0));
        assert_eq!(after.features.slice_axis(Axis(0), Slice::from(1..)), rows);
        assert_eq!(after.beats, [8, 38]);
    }
}
