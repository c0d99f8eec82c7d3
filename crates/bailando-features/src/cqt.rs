//! Constant-Q magnitudes, octave by octave from the top (FEATURES section 6).

use bailando_core::CancelToken;
use ndarray::Array2;
use rustfft::num_complex::Complex;

use crate::{
    cqt_basis::{BasisMaker, Filter, frequency},
    decimate::{Decimation, Decimator},
    layout::{HOP, row_count},
    padding::Padding,
    stft::Stft,
    tuning::BINS_PER_OCTAVE,
};

/// Settings of the transform besides the tuning.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CqtSettings {
    pub(crate) sample_rate: f64,
    pub(crate) octaves: usize,
    /// Filter length in periods of its frequency.
    pub(crate) quality: f64,
    pub(crate) decimation: Decimation,
    pub(crate) padding: Padding,
}

/// The transform; only its filters are made for each clip.
pub(crate) struct Cqt {
    settings: CqtSettings,
    basis: BasisMaker,
    stft: Stft,
    spectrum: Vec<Complex<f32>>,
    decimator: Decimator,
}

impl Cqt {
    pub(crate) fn new(settings: CqtSettings) -> Self {
        // The longest filter of the top octave at the lowest tuning, -0.5.
        let lowest_of_top = frequency(BINS_PER_OCTAVE * (settings.octaves - 1), -0.5);
        let longest = settings.quality * settings.sample_rate / lowest_of_top;
        let frame = (longest.ceil() as usize).next_power_of_two();
        Self {
            settings,
            basis: BasisMaker::new(frame, settings.quality),
            stft: Stft::rectangular(frame, settings.padding),
            spectrum: vec![Complex::default(); frame / 2 + 1],
            decimator: Decimator::new(settings.decimation),
        }
    }

    /// CQT bins of all octaves.
    pub(crate) fn bins(&self) -> usize {
        BINS_PER_OCTAVE * self.settings.octaves
    }

    /// Magnitudes `[T, bins]` of `signal` for the given tuning (fraction of a bin); `cancel` is
    /// checked before every octave.
    pub(crate) fn magnitudes(
        &mut self,
        signal: &[f32],
        tuning: f64,
        cancel: &CancelToken,
    ) -> Array2<f32> {
        let top_octave = BINS_PER_OCTAVE * (self.settings.octaves - 1);
        let frequencies = (top_octave..self.bins()).map(|bin| frequency(bin, tuning));
        let filters = self.basis.filters(frequencies, self.settings.sample_rate);

        let mut magnitudes = Array2::zeros((row_count(signal.len()), self.bins()));
        let mut halved: Option<Vec<f32>> = None;
        for halvings in (0..self.settings.octaves).take_while(|_| !cancel.is_cancelled()) {
            if halvings > 0 {
                let previous = halved.as_deref().unwrap_or(signal);
                halved = Some(self.decimator.run(previous));
            }
            let signal = halved.as_deref().unwrap_or(signal);
            let columns = self.columns(halvings, tuning, &filters);
            self.octave(signal, HOP >> halvings, columns, &mut magnitudes);
        }
        magnitudes
    }

    /// The columns of the octave that is `halvings` below the top one: number, gain and filter of
    /// each.
    fn columns<'f>(
        &self,
        halvings: usize,
        tuning: f64,
        filters: &'f [Filter],
    ) -> Vec<(usize, f32, &'f Filter)> {
        let first = BINS_PER_OCTAVE * (self.settings.octaves - 1 - halvings);
        let columns = (first..).zip(filters);
        columns.map(|(bin, filter)| (bin, self.gain(bin, halvings, tuning), filter)).collect()
    }

    fn octave(
        &mut self,
        signal: &[f32],
        hop: usize,
        columns: Vec<(usize, f32, &Filter)>,
        magnitudes: &mut Array2<f32>,
    ) {
        for (row, mut magnitudes) in magnitudes.rows_mut().into_iter().enumerate() {
            self.stft.frame(signal, row * hop, &mut self.spectrum);
            for &(column, gain, filter) in &columns {
                magnitudes[column] = gain * respond(filter, &self.spectrum).norm_sqr().sqrt();
            }
        }
    }

    /// Level of the octave over the square root of the filter's length at the original rate.
    fn gain(&self, bin: usize, halvings: usize, tuning: f64) -> f32 {
        let hz = frequency(bin, tuning);
        let length = self.basis.filter_length(hz, self.settings.sample_rate);
        ((1_u64 << halvings) as f64 / length).sqrt() as f32
    }
}

fn respond(filter: &Filter, spectrum: &[Complex<f32>]) -> Complex<f32> {
    filter
        .response
        .iter()
        .zip(&spectrum[filter.first_bin..])
        .map(|(weight, bin)| weight * bin)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cqt() -> Cqt {
        let ratio = 2.0_f64.powf(1.0 / 18.0);
        Cqt::new(CqtSettings {
            sample_rate: 3_840.0,
            octaves: 5,
            quality: (ratio + 1.0) / (ratio - 1.0),
            decimation: Decimation::SoxrHq,
            padding: Padding::Zeros,
        })
    }

    #[test]
    fn a_sine_peaks_at_its_bin_with_the_level_of_its_octave() {
        let mut cqt = cqt();
        assert_eq!(cqt.spectrum.len(), 257);
        let tuning = 0.2;
        for bin in [40, 100, 150] {
            let hz = frequency(bin, tuning);
            let sine: Vec<f32> = (0..3_840 * 4)
                .map(|i| (std::f64::consts::TAU * hz * f64::from(i) / 3_840.0).sin() as f32)
                .collect();
            let magnitudes = cqt.magnitudes(&sine, tuning, &CancelToken::new());
            assert_eq!(magnitudes.dim(), (31, 180));
            let row = magnitudes.row(15);
            let peak = (0..180).max_by(|&a, &b| row[a].total_cmp(&row[b]));
            assert_eq!(peak, Some(bin));
            // An L1-normalised filter of length L, scaled by L / sqrt(L), halves the amplitude.
            let expected = (cqt.settings.quality * 3_840.0 / hz).sqrt() / 2.0;
            let ratio = f64::from(row[bin]) / expected;
            assert!((ratio - 1.0).abs() < 0.02, "bin {bin}: {ratio}");
        }
    }
}
