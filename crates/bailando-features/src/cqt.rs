//! Constant-Q magnitudes, octave by octave from the top (FEATURES section 6).

use ndarray::Array2;
use rustfft::num_complex::Complex;

use super::{
    HOP,
    cqt_basis::{BasisMaker, Filter, frequency},
    decimate::{Decimation, Decimator},
    padding::Padding,
    row_count,
    stft::Stft,
    tuning::BINS_PER_OCTAVE,
};

/// What the transform depends on besides the tuning.
#[derive(Clone, Copy, Debug)]
pub(super) struct CqtSettings {
    pub(super) sample_rate: f64,
    pub(super) octaves: usize,
    /// Filter length in periods of its frequency.
    pub(super) quality: f64,
    pub(super) decimation: Decimation,
    pub(super) padding: Padding,
}

/// The transform; only its filters are made anew for each clip.
pub(super) struct Cqt {
    settings: CqtSettings,
    basis: BasisMaker,
    stft: Stft,
    spectrum: Vec<Complex<f32>>,
    decimator: Decimator,
}

impl Cqt {
    pub(super) fn new(settings: CqtSettings) -> Self {
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
    pub(super) fn bins(&self) -> usize {
        BINS_PER_OCTAVE * self.settings.octaves
    }

    /// Magnitudes `[T, bins]` of `signal` for the given tuning (fraction of a bin); `goes_on` is asked before
    /// every octave.
    pub(super) fn magnitudes(
        &mut self,
        signal: &[f32],
        tuning: f64,
        goes_on: impl Fn() -> bool,
    ) -> Array2<f32> {
        let top_octave = BINS_PER_OCTAVE * (self.settings.octaves - 1);
        let frequencies = (top_octave..self.bins()).map(|bin| frequency(bin, tuning));
        let filters = self.basis.filters(frequencies, self.settings.sample_rate);

        let mut magnitudes = Array2::zeros((row_count(signal.len()), self.bins()));
        let mut halved: Option<Vec<f32>> = None;
        for halvings in (0..self.settings.octaves).take_while(|_| goes_on()) {
            if halvings > 0 {
                let previous = halved.as_deref().unwrap_or(signal);
                halved = Some(self.decimator.run(previous));
            }
            self.octave(
                halved.as_deref().unwrap_or(signal),
                halvings,
                &filters,
                tuning,
                &mut magnitudes,
            );
        }
        magnitudes
    }

    /// Fills the columns of the octave that is `halvings` below the top one.
    fn octave(
        &mut self,
        signal: &[f32],
        halvings: usize,
        filters: &[Filter],
        tuning: f64,
        magnitudes: &mut Array2<f32>,
    ) {
        let first = BINS_PER_OCTAVE * (self.settings.octaves - 1 - halvings);
        let columns = first..first + BINS_PER_OCTAVE;
        let gains: Vec<f32> = columns
            .clone()
            .map(|bin| self.gain(bin, halvings, tuning))
            .collect();
        let hop = HOP >> halvings;
        for (row, mut magnitudes) in magnitudes.rows_mut().into_iter().enumerate() {
            self.stft.frame(signal, row * hop, &mut self.spectrum);
            let cells = magnitudes.iter_mut().skip(first);
            for ((cell, filter), gain) in cells.zip(filters).zip(&gains) {
                *cell = gain * respond(filter, &self.spectrum).norm_sqr().sqrt();
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
            let magnitudes = cqt.magnitudes(&sine, tuning, || true);
            assert_eq!(magnitudes.dim(), (31, 180));
            let row = magnitudes.row(15);
            let peak = (0..180).max_by(|&a, &b| row[a].total_cmp(&row[b]));
            assert_eq!(peak, Some(bin));
            // An L1-normalised filter of length L, scaled by L / sqrt(L), halves the amplitude.
            let expected = (cqt.settings.quality * 3_840.0 / hz).sqrt() / 2.0;
            assert!(
                (f64::from(row[bin]) / expected - 1.0).abs() < 0.02,
                "bin {bin}: {} against {expected}",
                row[bin]
            );
        }
    }
}
