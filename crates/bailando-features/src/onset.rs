//! Onset strength of the percussive part (FEATURES section 8).

use std::thread;

use ndarray::{Array2, ArrayRef1, ArrayViewMut2, Axis};

use crate::{
    decibel::{Reference, to_decibels},
    layout::{HOP, row_count},
    median::middle_two,
    mel::{BANDS, MelBank},
    padding::Padding,
    stft::{BINS, FRAME, MagnitudeFrames},
};

/// Rows by which the envelope is late: the difference itself, and half a frame.
const SHIFT: usize = 1 + FRAME / (2 * HOP);

/// Rows below which a second thread is not worth its start.
const WORTH_A_THREAD: usize = 128;

/// Onset strength: the median rise of the mel bands between rows.
pub(crate) struct Onset {
    /// One for each thread.
    frames: [MagnitudeFrames; 2],
    bank: MelBank,
    rises: [f32; BANDS],
}

impl Onset {
    pub(crate) fn new(sample_rate: f64, top_hz: f64, padding: Padding) -> Self {
        Self {
            frames: [(); 2].map(|()| MagnitudeFrames::new(padding)),
            bank: MelBank::new(sample_rate, BINS, top_hz),
            rises: [0.0; BANDS],
        }
    }

    /// Envelope `[T]` of the percussive part.
    pub(crate) fn envelope(&mut self, percussive: &[f32]) -> Vec<f32> {
        let rows = row_count(percussive.len());
        let mut mel = self.mel(percussive, rows);
        to_decibels(&mut mel, Reference::One);

        let mut envelope = vec![0.0; rows];
        for (strength, pair) in envelope.iter_mut().skip(SHIFT).zip(mel.windows((2, BANDS))) {
            *strength = self.median_rise(&pair.row(0), &pair.row(1));
        }
        envelope
    }

    fn mel(&mut self, percussive: &[f32], rows: usize) -> Array2<f32> {
        let mut mel = Array2::zeros((rows, BANDS));
        let ([one, other], bank) = (&mut self.frames, &self.bank);
        let fill = |frames: &mut MagnitudeFrames, first: usize, mut mel: ArrayViewMut2<'_, f32>| {
            for (row, power) in (first..).zip(mel.rows_mut()) {
                bank.power(frames.row(percussive, row), power);
            }
        };
        if rows < WORTH_A_THREAD {
            fill(one, 0, mel.view_mut());
            return mel;
        }
        let half = rows / 2;
        let (first, second) = mel.view_mut().split_at(Axis(0), half);
        thread::scope(|scope| {
            scope.spawn(|| fill(other, half, second));
            fill(one, 0, first);
        });
        mel
    }

    fn median_rise(&mut self, before: &ArrayRef1<f32>, after: &ArrayRef1<f32>) -> f32 {
        for ((rise, before), after) in self.rises.iter_mut().zip(before).zip(after) {
            *rise = (after - before).max(0.0);
        }
        middle_two(&mut self.rises, f32::total_cmp)
            .map_or(0.0, |(lower, upper)| (lower + upper) / 2.0)
    }
}

#[cfg(test)]
mod tests {
    use ndarray::aview1;

    use super::*;

    #[test]
    fn a_click_shows_three_rows_after_the_rise() {
        let mut onset = Onset::new(3_840.0, 1_920.0, Padding::Zeros);
        let mut signal = vec![0.0; 512 * 40];
        signal[512 * 20] = 1.0;
        let envelope = onset.envelope(&signal);
        assert_eq!(envelope.len(), 41);
        // The first frame that holds the click is row 19 (it ends at 512 * 19 + 1,023); the rise
        // from row 18 is difference 18, shown at row 21.
        let first = envelope.iter().position(|&strength| strength > 0.0);
        assert_eq!(first, Some(21));
    }

    #[test]
    fn the_median_is_between_the_two_middle_rises() {
        let mut onset = Onset::new(3_840.0, 1_920.0, Padding::Zeros);
        let before = [0.0; BANDS];
        let after: [f32; BANDS] = std::array::from_fn(|band| band as f32 - 60.0);
        // 61 bands do not rise; sorted elements 64 and 65 (from 1) are the rises 3 and 4.
        assert_eq!(onset.median_rise(&aview1(&before), &aview1(&after)), 3.5);
    }

    #[test]
    fn silence_has_no_onsets() {
        let mut onset = Onset::new(30_720.0, 11_025.0, Padding::Reflect);
        let silence = vec![0.0; 5_000];
        assert!(onset.envelope(&silence).iter().all(|&x| x == 0.0));
    }
}
