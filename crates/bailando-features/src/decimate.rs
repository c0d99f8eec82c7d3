//! Halving the sample rate between the octaves of the constant-Q transform (FEATURES sections 6
//! and 11.4).

use std::f64::consts::{PI, SQRT_2};

use bailando_core::dsp::{bessel_i0, dot};

/// The filter that is reproduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Decimation {
    /// soxr "HQ": the symmetric filter of FEATURES section 6.
    SoxrHq,
    /// resampy "kaiser_fast": 16 zero crossings, passband 0.85 of the new Nyquist.
    KaiserFast,
}

/// A zero-phase filter that drops every other sample, with gain `sqrt(2)`.
pub(crate) struct Decimator {
    taps: Vec<f32>,
    // resampy gives floor(n / 2) samples; librosa appends a zero if ceil(n / 2) is one more.
    drops_odd_end: bool,
}

impl Decimator {
    pub(crate) fn new(kind: Decimation) -> Self {
        match kind {
            Decimation::SoxrHq => Self {
                taps: windowed_sinc(0.478_435_91, 195, 195.0, 13.1064),
                drops_odd_end: false,
            },
            Decimation::KaiserFast => Self {
                taps: windowed_sinc(0.425, 31, 32.0, 8.555_504_641_634_386),
                drops_odd_end: true,
            },
        }
    }

    /// Returns `ceil(n / 2)` samples; output `m` lies at input `2 m`, and outside `signal` is
    /// silence.
    pub(crate) fn run(&self, signal: &[f32]) -> Vec<f32> {
        let mut halved: Vec<f32> = (0..signal.len().div_ceil(2))
            .map(|output| self.filter(signal, 2 * output) * SQRT_2 as f32)
            .collect();
        if self.drops_odd_end
            && !signal.len().is_multiple_of(2)
            && let Some(last) = halved.last_mut()
        {
            *last = 0.0;
        }
        halved
    }

    fn filter(&self, signal: &[f32], centre: usize) -> f32 {
        let half = self.taps.len() / 2;
        let skipped = half.saturating_sub(centre);
        let start = centre.saturating_sub(half);
        let end = signal.len().min(centre + half + 1);
        dot(&self.taps[skipped..], &signal[start..end])
    }
}

/// `cutoff sinc(cutoff n)` under a Kaiser window that reaches zero crossing `support`, for
/// `n = -half..=half`; `cutoff` is a fraction of the input's sample rate.
fn windowed_sinc(cutoff: f64, half: usize, support: f64, beta: f64) -> Vec<f32> {
    let half = half as isize;
    (-half..=half)
        .map(|n| {
            let n = n as f64;
            let angle = PI * cutoff * n;
            let sinc = if n == 0.0 { 1.0 } else { angle.sin() / angle };
            let window =
                bessel_i0(beta * (1.0 - (n / support).powi(2)).max(0.0).sqrt()) / bessel_i0(beta);
            (cutoff * sinc * window) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soxr_filter_has_unit_gain_at_dc_and_the_length_is_rounded_up() {
        let decimator = Decimator::new(Decimation::SoxrHq);
        let gain: f64 = decimator.taps.iter().map(|&tap| f64::from(tap)).sum();
        assert!((gain - 1.0).abs() < 2e-7, "{gain}");
        let out = decimator.run(&[1.0; 2_001]);
        assert_eq!(out.len(), 1_001);
        assert!((out[500] - SQRT_2 as f32).abs() < 1e-6);
    }

    #[test]
    fn low_tones_pass_in_phase_and_high_tones_vanish() {
        for kind in [Decimation::SoxrHq, Decimation::KaiserFast] {
            let decimator = Decimator::new(kind);
            let tone = |step: f64| -> Vec<f32> {
                (0..4_000).map(|i| (step * f64::from(i)).sin() as f32).collect()
            };
            let low = decimator.run(&tone(0.3));
            for (m, sample) in low.iter().enumerate().skip(200).take(1_600) {
                let expected = SQRT_2 * (0.6 * m as f64).sin();
                assert!((f64::from(*sample) - expected).abs() < 1e-3, "{kind:?} {m}");
            }
            let high = decimator.run(&tone(2.4));
            assert!(high[200..1_800].iter().all(|x| x.abs() < 1e-3), "{kind:?}");
        }
    }

    #[test]
    fn every_output_is_the_filter_sum_at_the_edges_too() {
        let signal: Vec<f32> = (0..301).map(|i| (i as f32 * 1.3).sin()).collect();
        for kind in [Decimation::SoxrHq, Decimation::KaiserFast] {
            let decimator = Decimator::new(kind);
            let half = decimator.taps.len() / 2;
            for (m, got) in decimator.run(&signal).iter().enumerate() {
                if m == 150 && decimator.drops_odd_end {
                    assert_eq!(*got, 0.0);
                    continue;
                }
                let direct: f64 = decimator
                    .taps
                    .iter()
                    .enumerate()
                    .filter_map(|(k, &tap)| {
                        let index = (2 * m + k).checked_sub(half)?;
                        Some(f64::from(tap) * f64::from(*signal.get(index)?))
                    })
                    .sum();
                let error = f64::from(*got) - direct * SQRT_2;
                assert!(error.abs() < 1e-6, "{kind:?} {m}");
            }
        }
    }
}
