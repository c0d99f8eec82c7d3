//! Frequency responses of the constant-Q filters of one octave (FEATURES section 6).

use std::{f64::consts::TAU, sync::Arc};

use rustfft::{Fft, FftPlanner, num_complex::Complex};

use crate::{stft::hann_periodic, tuning::BINS_PER_OCTAVE};

/// C1 with A at 440 Hz.
const LOWEST_HZ: f64 = 32.703_195_662_574_83;
/// Share of a filter's summed magnitudes that is dropped from its weakest bins.
const SPARSITY: f64 = 0.01;

/// Maker of a clip's basis, which depends on its tuning.
///
/// All octaves share one basis: each is half the frequency at half the rate.
pub(crate) struct BasisMaker {
    frame: usize,
    quality: f64,
    fft: Arc<dyn Fft<f64>>,
    samples: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
    magnitudes: Vec<f64>,
}

/// One filter: the bins that survive, from `first_bin` on.
#[derive(Clone, Debug)]
pub(crate) struct Filter {
    pub(crate) first_bin: usize,
    pub(crate) response: Vec<Complex<f32>>,
}

/// Frequency of CQT bin `index` in Hz.
pub(crate) fn frequency(index: usize, tuning: f64) -> f64 {
    LOWEST_HZ * ((tuning + index as f64) / BINS_PER_OCTAVE as f64).exp2()
}

impl BasisMaker {
    /// `frame`: samples of a CQT frame, at least as many as the longest filter has.
    pub(crate) fn new(frame: usize, quality: f64) -> Self {
        let fft = FftPlanner::new().plan_fft_forward(frame);
        Self {
            frame,
            quality,
            samples: vec![Complex::default(); frame],
            scratch: vec![Complex::default(); fft.get_inplace_scratch_len()],
            fft,
            magnitudes: Vec::with_capacity(frame / 2 + 1),
        }
    }

    /// Length of the filter at `hz`, in samples, not rounded.
    pub(crate) fn filter_length(&self, hz: f64, sample_rate: f64) -> f64 {
        self.quality * sample_rate / hz
    }

    /// The filters at `frequencies` (Hz), for a signal at `sample_rate`.
    pub(crate) fn filters(
        &mut self,
        frequencies: impl Iterator<Item = f64>,
        sample_rate: f64,
    ) -> Vec<Filter> {
        frequencies
            .map(|hz| {
                self.respond(hz, sample_rate);
                self.sparsify()
            })
            .collect()
    }

    /// Leaves the filter's frequency response in `self.samples`.
    fn respond(&mut self, hz: f64, sample_rate: f64) {
        let length = self.filter_length(hz, sample_rate);
        let first = (-length / 2.0).floor() as isize;
        let count = ((length / 2.0).floor() as isize - first) as usize;
        let window = hann_periodic(count);
        // |g| is the window itself.
        let gain = length / self.frame as f64 / window.iter().sum::<f64>();
        self.samples.fill(Complex::default());
        let left = (self.frame - count) / 2;
        for ((sample, time), weight) in self.samples[left..].iter_mut().zip(first..).zip(&window) {
            let phase = TAU * hz * time as f64 / sample_rate;
            *sample = Complex::from_polar(weight * gain, phase);
        }
        self.fft.process_with_scratch(&mut self.samples, &mut self.scratch);
    }

    /// Cuts the response down to its strong bins; weak ones between them become zero.
    fn sparsify(&mut self) -> Filter {
        let bins = &self.samples[..=self.frame / 2];
        self.magnitudes.clear();
        self.magnitudes.extend(bins.iter().map(|bin| bin.norm()));
        self.magnitudes.sort_unstable_by(f64::total_cmp);
        let total: f64 = self.magnitudes.iter().sum();
        let mut cumulated = 0.0;
        let threshold = self
            .magnitudes
            .iter()
            .copied()
            .find(|magnitude| {
                cumulated += magnitude / total;
                cumulated >= SPARSITY
            })
            .unwrap_or(0.0);
        let kept = |bin: &Complex<f64>| bin.norm() >= threshold;
        let first_bin = bins.iter().position(kept).unwrap_or(0);
        let end = bins.iter().rposition(kept).map_or(0, |last| last + 1);
        let response = bins[first_bin..end.max(first_bin)]
            .iter()
            .map(|bin| match kept(bin) {
                true => Complex::new(bin.re as f32, bin.im as f32),
                false => Complex::default(),
            })
            .collect();
        Filter { first_bin, response }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_are_those_of_the_scale() {
        assert!((frequency(0, 0.0) - 32.703_195_662_574_83).abs() < 1e-12);
        assert!((frequency(36 * 3 + 27, 0.0) - 440.0).abs() < 1e-9);
        assert!((frequency(1, -0.5) / frequency(0, 0.5) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_filter_keeps_99_percent_and_peaks_at_its_frequency() {
        let ratio = 2.0_f64.powf(1.0 / 18.0);
        let mut maker = BasisMaker::new(512, (ratio + 1.0) / (ratio - 1.0));
        let hz = frequency(36 * 4 + 10, 0.0);
        let filter = maker.filters(std::iter::once(hz), 3_840.0).remove(0);
        let full: f64 = maker.samples[..257].iter().map(|bin| bin.norm()).sum();
        let kept: f64 = filter.response.iter().map(|c| f64::from(c.norm())).sum();
        assert!(kept > 0.98 * full && kept < full, "{kept} of {full}");
        let peak = filter
            .response
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.norm().total_cmp(&b.1.norm()))
            .map(|(k, _)| k + filter.first_bin);
        assert_eq!(peak, Some((hz * 512.0 / 3_840.0).round() as usize));
    }
}
