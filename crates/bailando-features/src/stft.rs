//! Short-time Fourier transform (FEATURES sections 2 and 6).

use std::f64::consts::TAU;

use rustfft::num_complex::Complex;

use crate::{fft::ForwardFft, layout::HOP, padding::Padding};

/// Samples of a frame of the mel, separation, tuning and onset stages.
pub(crate) const FRAME: usize = 2_048;
/// Bins of such a frame.
pub(crate) const BINS: usize = FRAME / 2 + 1;

/// A transform of one frame at a time, centred on a sample; spectra are stored as f32.
pub(crate) struct Stft {
    window: Vec<f64>,
    padding: Padding,
    samples: Vec<f32>,
    fft: ForwardFft,
}

impl Stft {
    /// Frames of [`FRAME`] samples under a periodic Hann window.
    pub(crate) fn hann(padding: Padding) -> Self {
        Self::with_window(hann_periodic(FRAME), padding)
    }

    /// Frames of `n` samples as they are.
    pub(crate) fn rectangular(n: usize, padding: Padding) -> Self {
        Self::with_window(vec![1.0; n], padding)
    }

    fn with_window(window: Vec<f64>, padding: Padding) -> Self {
        Self {
            samples: vec![0.0; window.len()],
            fft: ForwardFft::new(window.len()),
            window,
            padding,
        }
    }

    /// Spectrum (`n / 2 + 1` bins, unscaled) of the frame whose middle is at sample `centre`.
    pub(crate) fn frame(&mut self, signal: &[f32], centre: usize, spectrum: &mut [Complex<f32>]) {
        let start = centre as isize - (self.window.len() / 2) as isize;
        self.padding.fill(signal, start, &mut self.samples);
        let weighted = self.samples.iter().zip(&self.window);
        for (input, (&sample, &weight)) in self.fft.input().iter_mut().zip(weighted) {
            *input = f64::from(sample) * weight;
        }
        for (bin, exact) in spectrum.iter_mut().zip(self.fft.run()) {
            *bin = Complex::new(exact.re as f32, exact.im as f32);
        }
    }
}

/// The magnitudes of one row's frame at a time, under a Hann window.
pub(crate) struct MagnitudeFrames {
    stft: Stft,
    spectrum: Vec<Complex<f32>>,
    magnitudes: Vec<f32>,
}

impl MagnitudeFrames {
    pub(crate) fn new(padding: Padding) -> Self {
        Self {
            stft: Stft::hann(padding),
            spectrum: vec![Complex::default(); BINS],
            magnitudes: vec![0.0; BINS],
        }
    }

    /// Magnitudes `[1025]` of the frame of feature row `row`.
    pub(crate) fn row(&mut self, signal: &[f32], row: usize) -> &[f32] {
        self.stft.frame(signal, row * HOP, &mut self.spectrum);
        magnitudes(&self.spectrum, &mut self.magnitudes);
        &self.magnitudes
    }
}

/// Writes `|X|`, rounded once to f32.
pub(crate) fn magnitudes(spectrum: &[Complex<f32>], magnitudes: &mut [f32]) {
    for (magnitude, bin) in magnitudes.iter_mut().zip(spectrum) {
        let (re, im) = (f64::from(bin.re), f64::from(bin.im));
        *magnitude = (re * re + im * im).sqrt() as f32;
    }
}

/// The window `0.5 - 0.5 cos(2 pi i / n)`.
pub(crate) fn hann_periodic(n: usize) -> Vec<f64> {
    (0..n).map(|i| 0.5 - 0.5 * (TAU * i as f64 / n as f64).cos()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_equals_the_windowed_fourier_sum() {
        let signal: Vec<f32> =
            (0..3_000).map(|i| (i as f32 * 0.37).sin() + 0.2 * (i as f32 * 1.9).cos()).collect();
        let mut stft = Stft::hann(Padding::Zeros);
        let mut spectrum = vec![Complex::default(); BINS];
        // One frame hangs over the start, one over the end, one lies inside.
        for centre in [512_usize, 1_536, 2_560] {
            stft.frame(&signal, centre, &mut spectrum);
            for bin in [0_usize, 1, 121, 700, 1_024] {
                let mut direct = Complex::new(0.0, 0.0);
                for n in 0..FRAME {
                    let sample = (centre + n)
                        .checked_sub(1_024)
                        .and_then(|i| signal.get(i))
                        .map_or(0.0, |&s| f64::from(s));
                    let window = 0.5 - 0.5 * (TAU * n as f64 / 2_048.0).cos();
                    direct += Complex::from_polar(
                        sample * window,
                        -TAU * (bin * n % FRAME) as f64 / 2_048.0,
                    );
                }
                let got = spectrum[bin];
                let error = (Complex::new(f64::from(got.re), f64::from(got.im)) - direct).norm();
                assert!(error < 1e-4, "centre {centre}, bin {bin}: {error}");
            }
        }
    }

    #[test]
    fn a_rectangular_frame_of_a_constant_holds_only_its_sum() {
        let mut stft = Stft::rectangular(8, Padding::Reflect);
        let mut spectrum = vec![Complex::default(); 5];
        stft.frame(&[0.5; 20], 0, &mut spectrum);
        let mut magnitude = [0.0; 5];
        magnitudes(&spectrum, &mut magnitude);
        assert_eq!(magnitude, [4.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
