//! The spectrogram that the beat network reads (BEATS, input and spectrogram).

use std::{f64::consts::TAU, fmt, ops::Range, sync::Arc};

use ndarray::Array2;
use rustfft::{Fft, FftPlanner, num_complex::Complex};

use super::filterbank::{BANDS, BINS, FilterBank};

/// Samples of a frame, 64 ms, and from one to the next, 20 ms.
const FRAME: usize = 1_411;
const HOP: usize = 441;
/// Frames per second.
pub(super) const FRAMES_PER_SECOND: f64 = 50.0;
/// Columns of a row: the bands, and their rises.
pub(super) const ROW: usize = 2 * BANDS;
/// RMS of a song as the network knows them: -14 dB of full scale.
const LEVEL: f64 = 0.199_526_231_496_887_97;

/// Frames of a signal of `samples` samples.
pub(super) fn frame_count(samples: usize) -> usize {
    samples.div_ceil(HOP)
}

/// The factor that brings a song to the level that the network knows; 1 for silence.
pub(super) fn gain(signal: &[f32]) -> f32 {
    let power: f64 = signal.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
    let rms = (power / signal.len().max(1) as f64).sqrt();
    if rms > 0.0 { (LEVEL / rms).min(f64::from(f32::MAX)) as f32 } else { 1.0 }
}

/// Rows of a signal, one frame after the other.
pub(super) struct Spectrogram {
    window: Vec<f32>,
    bank: FilterBank,
    fft: Arc<dyn Fft<f32>>,
    /// Two frames: one in the real parts, the next in the imaginary ones.
    pair: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
    magnitudes: [[f32; BINS]; 2],
    /// The bands of the frame before, once there is one.
    before: Option<[f32; BANDS]>,
}

impl Spectrogram {
    pub(super) fn new() -> Self {
        let fft = FftPlanner::new().plan_fft_forward(FRAME);
        let hann = |n: usize| 0.5 - 0.5 * (TAU * n as f64 / (FRAME - 1) as f64).cos();
        Self {
            window: (0..FRAME).map(|n| hann(n) as f32).collect(),
            bank: FilterBank::new(),
            pair: vec![Complex::default(); FRAME],
            scratch: vec![Complex::default(); fft.get_inplace_scratch_len()],
            fft,
            magnitudes: [[0.0; BINS]; 2],
            before: None,
        }
    }

    /// Forgets the frame before: the next one is a signal's first.
    pub(super) fn restart(&mut self) {
        self.before = None;
    }

    /// Rows `[frames, 272]` of some frames of `signal` times `gain`, which follow those of the call
    /// before.
    pub(super) fn rows(&mut self, signal: &[f32], gain: f32, frames: Range<usize>) -> Array2<f32> {
        let mut rows = Array2::zeros((frames.len(), ROW));
        for (at, mut row) in rows.rows_mut().into_iter().enumerate() {
            if at % 2 == 0 {
                self.transform(signal, gain, frames.start + at);
            }
            let mut bands = [0.0; BANDS];
            self.bank.apply(&self.magnitudes[at % 2], &mut bands);
            for band in &mut bands {
                *band = (1.0 + *band).log10();
            }
            let before = self.before.unwrap_or(bands);
            let rises = bands.iter().zip(&before).map(|(now, before)| (now - before).max(0.0));
            for (value, new) in row.iter_mut().zip(bands.iter().copied().chain(rises)) {
                *value = new;
            }
            self.before = Some(bands);
        }
        rows
    }

    /// Leaves the magnitudes of a frame and of the next.
    fn transform(&mut self, signal: &[f32], gain: f32, frame: usize) {
        let sample = |frame: usize, n: usize| {
            // Frame i is centred on sample 441 i; outside of the signal is silence.
            let index = (frame * HOP + n).checked_sub(FRAME / 2);
            index.and_then(|index| signal.get(index)).map_or(0.0, |sample| sample * gain)
        };
        for (n, (value, weight)) in self.pair.iter_mut().zip(&self.window).enumerate() {
            *value = Complex::new(sample(frame, n) * weight, sample(frame + 1, n) * weight);
        }
        self.fft.process_with_scratch(&mut self.pair, &mut self.scratch);
        let [one, next] = &mut self.magnitudes;
        for (bin, (one, next)) in one.iter_mut().zip(next).enumerate() {
            // The spectra of two real signals: the even and the odd part of that of their sum.
            let (here, there) = (self.pair[bin], self.pair[(FRAME - bin) % FRAME].conj());
            *one = ((here + there) * 0.5).norm();
            *next = ((here - there) * 0.5).norm();
        }
    }
}

impl fmt::Debug for Spectrogram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Spectrogram").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use bailando_testkit::sound::noise;

    use super::*;

    #[test]
    fn magnitudes_are_those_of_the_windowed_fourier_sum() {
        let signal = noise(2_000);
        let mut spectrogram = Spectrogram::new();
        // Frame 0 hangs over the start, 4 over the end, 5 is nearly outside.
        for frame in [0_usize, 1, 4] {
            spectrogram.transform(&signal, 0.5, frame);
            for (place, bin) in [(0, 0_usize), (0, 7), (1, 300), (0, 704), (1, 704)] {
                let mut direct = Complex::new(0.0, 0.0);
                for n in 0..FRAME {
                    let index = ((frame + place) * HOP + n).checked_sub(705);
                    let sample = index.and_then(|i| signal.get(i)).map_or(0.0, |&s| f64::from(s));
                    let window = 0.5 - 0.5 * (TAU * n as f64 / 1_410.0).cos();
                    let angle = -TAU * (bin * n % FRAME) as f64 / FRAME as f64;
                    direct += Complex::from_polar(0.5 * sample * window, angle);
                }
                let found = f64::from(spectrogram.magnitudes[place][bin]);
                assert!((found - direct.norm()).abs() < 1e-5, "{frame} {place} {bin}: {found}");
            }
        }
    }

    #[test]
    fn pieces_give_the_rows_of_the_whole_and_only_rises_rise() {
        let signal = noise(30 * HOP + 1);
        assert_eq!((frame_count(signal.len()), frame_count(0)), (31, 0));
        let mut spectrogram = Spectrogram::new();
        let whole = spectrogram.rows(&signal, 1.0, 0..31);
        spectrogram.restart();
        let first = spectrogram.rows(&signal, 1.0, 0..10);
        let second = spectrogram.rows(&signal, 1.0, 10..31);
        assert_eq!(ndarray::concatenate![ndarray::Axis(0), first, second], whole);
        for band in 0..BANDS {
            assert_eq!(whole[[0, BANDS + band]], 0.0);
            let rise = (whole[[5, band]] - whole[[4, band]]).max(0.0);
            assert_eq!(whole[[5, BANDS + band]], rise);
        }
    }

    #[test]
    fn every_song_comes_to_one_level_and_silence_stays_silent() {
        let quiet: Vec<f32> = noise(9_000).iter().map(|x| x * 1e-3).collect();
        let factor = gain(&quiet);
        let power: f32 = quiet.iter().map(|x| (x * factor).powi(2)).sum();
        let rms = (power / 9_000.0).sqrt();
        assert!((20.0 * rms.log10() + 14.0).abs() < 1e-3, "{rms}");
        assert_eq!((gain(&[0.0; 50]), gain(&[])), (1.0, 1.0));
        assert!(gain(&[f32::MIN_POSITIVE; 9]).is_finite());
    }
}
