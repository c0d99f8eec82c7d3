//! Deviation of the music from the 36-tone scale on A 440 (FEATURES section 5).
//!
//! The result is the fullest bin of a histogram, often by a handful of entries, so every value is
//! rounded to f32 exactly where the reference stores one.

use crate::median::middle_two;

/// CQT bins per octave; the tuning is a fraction of one.
pub(crate) const BINS_PER_OCTAVE: usize = 36;

const LOWEST_HZ: f64 = 150.0;
const HIGHEST_HZ: f64 = 4_000.0;
const THRESHOLD: f32 = 0.1;
const HISTOGRAM_BINS: usize = 100;
const LOWEST_A_HZ: f32 = 27.5;

/// Estimator of the tuning: collects spectral peaks frame by frame, then gives one number for the
/// clip.
pub(crate) struct Tuner {
    hz_per_bin: f64,
    candidate_bins: std::ops::Range<usize>,
    pitches: Vec<f32>,
    peak_magnitudes: Vec<f32>,
    scratch: Vec<f32>,
}

impl Tuner {
    /// Plans for magnitude frames of `bins` bins up to half of `sample_rate`.
    pub(crate) fn new(sample_rate: f64, bins: usize) -> Self {
        let hz_per_bin = sample_rate / (2 * (bins - 1)) as f64;
        let highest = HIGHEST_HZ.min(sample_rate / 2.0);
        let first = (LOWEST_HZ / hz_per_bin).ceil() as usize;
        // Exclusive; the last bin of the spectrum lies at half the rate and never qualifies.
        let end = (highest / hz_per_bin).ceil() as usize;
        Self {
            hz_per_bin,
            candidate_bins: first..end.min(bins - 1),
            pitches: Vec::new(),
            peak_magnitudes: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// Clears the peaks of the previous clip.
    pub(crate) fn start(&mut self) {
        self.pitches.clear();
        self.peak_magnitudes.clear();
    }

    /// Adds the peaks of one frame of magnitudes.
    pub(crate) fn observe(&mut self, magnitudes: &[f32]) {
        let threshold = THRESHOLD * magnitudes.iter().copied().fold(0.0, f32::max);
        let audible = |bin: usize| match magnitudes[bin] > threshold {
            true => magnitudes[bin],
            false => 0.0,
        };
        for bin in self.candidate_bins.clone() {
            let here = audible(bin);
            if here > audible(bin - 1) && here >= audible(bin + 1) {
                let [below, peak, above] = [bin - 1, bin, bin + 1].map(|bin| magnitudes[bin]);
                let shift = parabola_shift(below, peak, above);
                let slope = (above - below) / 2.0;
                let hz = (bin as f64 + f64::from(shift)) * self.hz_per_bin;
                self.pitches.push(hz as f32);
                self.peak_magnitudes.push(peak + 0.5 * slope * shift);
            }
        }
    }

    /// Tuning in fractions of a bin of [`BINS_PER_OCTAVE`], a multiple of 0.01 in [-0.5, 0.5); 0
    /// without any peak.
    pub(crate) fn estimate(&mut self) -> f64 {
        self.scratch.clone_from(&self.peak_magnitudes);
        let Some((lower, upper)) = middle_two(&mut self.scratch, f32::total_cmp) else {
            return 0.0;
        };
        let median = (lower + upper) / 2.0;
        let mut counts = [0_usize; HISTOGRAM_BINS];
        for (&pitch, &magnitude) in self.pitches.iter().zip(&self.peak_magnitudes) {
            if magnitude >= median {
                counts[histogram_bin(deviation(pitch))] += 1;
            }
        }
        // `max_by_key` keeps the last of equals: reversed, that is the first.
        let fullest = (0..HISTOGRAM_BINS).rev().max_by_key(|&bin| counts[bin]);
        fullest.map_or(0.0, left_edge)
    }
}

/// Where the parabola through three magnitudes peaks, relative to the middle one.
fn parabola_shift(below: f32, peak: f32, above: f32) -> f32 {
    let curvature = f64::from(above + below) - 2.0 * f64::from(peak);
    let slope = f64::from(above - below) / 2.0;
    match slope.abs() >= curvature.abs() {
        true => 0.0,
        false => (-slope / curvature) as f32,
    }
}

/// Distance of a pitch to the nearest of the 36 tones per octave, in [-0.5, 0.5).
fn deviation(pitch: f32) -> f32 {
    let octaves = f64::from(pitch / LOWEST_A_HZ).log2() as f32;
    let tones = BINS_PER_OCTAVE as f32 * octaves;
    let fraction = tones - tones.floor();
    match fraction >= 0.5 {
        true => fraction - 1.0,
        false => fraction,
    }
}

fn left_edge(bin: usize) -> f64 {
    bin as f64 * 0.01 - 0.5
}

/// Bin of the histogram over [-0.5, 0.5] by its exact edges.
fn histogram_bin(deviation: f32) -> usize {
    let deviation = f64::from(deviation);
    let guess = ((deviation + 0.5) * HISTOGRAM_BINS as f64) as usize;
    let last = HISTOGRAM_BINS - 1;
    let mut bin = guess.min(last);
    while bin > 0 && deviation < left_edge(bin) {
        bin -= 1;
    }
    while bin < last && deviation >= left_edge(bin + 1) {
        bin += 1;
    }
    bin
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_detuned_tone_is_found() {
        for hundredths in [-40_i32, -7, 0, 23, 49] {
            // A parabola around the tone, on an 1.875 Hz grid.
            let tone = 440.0 * 2.0_f64.powf((f64::from(hundredths) + 0.5) / 3_600.0);
            let mut tuner = Tuner::new(3_840.0, 1_025);
            let frame: Vec<f32> = (0..1_025)
                .map(|bin| (1e4 - (f64::from(bin) - tone / 1.875).powi(2)).max(0.0) as f32)
                .collect();
            tuner.observe(&frame);
            let got = tuner.estimate();
            let error = got - f64::from(hundredths) / 100.0;
            assert!(error.abs() < 0.0101, "{got}");
        }
    }

    #[test]
    fn silence_has_no_tuning_and_ties_go_to_the_lower_bin() {
        let mut tuner = Tuner::new(3_840.0, 1_025);
        tuner.observe(&[0.0; 1_025]);
        assert_eq!(tuner.estimate(), 0.0);

        let mut frame = [0.0; 1_025];
        frame[200] = 1.0;
        frame[301] = 1.0;
        tuner.observe(&frame);
        let bins = [200.0_f32, 301.0].map(|bin| histogram_bin(deviation(bin * 1.875)));
        assert_eq!(tuner.estimate(), left_edge(bins[0].min(bins[1])));
        tuner.start();
        assert_eq!(tuner.estimate(), 0.0);
    }

    #[test]
    fn histogram_edges_belong_to_the_bin_on_their_right() {
        assert_eq!(histogram_bin(-0.5), 0);
        assert_eq!(histogram_bin(0.0), 50);
        assert_eq!(histogram_bin(-1e-9), 49);
        assert_eq!(histogram_bin(0.499_999_97), 99);
    }

    #[test]
    fn the_parabola_peaks_where_it_should() {
        // y = 5 - (x - 0.25)^2
        let y = |x: f32| 5.0 - (x - 0.25) * (x - 0.25);
        assert!((parabola_shift(y(-1.0), y(0.0), y(1.0)) - 0.25).abs() < 1e-6);
        assert_eq!(parabola_shift(0.0, 0.4, 1.0), 0.0);
    }
}
