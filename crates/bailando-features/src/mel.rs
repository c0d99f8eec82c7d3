//! Mel bank on power spectra (FEATURES section 3).

/// Mel bands.
pub(crate) const BANDS: usize = 128;

/// A bank of triangles on the Slaney mel scale, each of area 1 in Hz.
pub(crate) struct MelBank {
    bands: Vec<Band>,
}

struct Band {
    first_bin: usize,
    weights: Vec<f32>,
}

impl MelBank {
    /// Plans bands from 0 to `top_hz` for spectra of `bins` bins up to half of `sample_rate`. Bands
    /// that hold no bin stay empty (FEATURES section 11.2).
    pub(crate) fn new(sample_rate: f64, bins: usize, top_hz: f64) -> Self {
        let hz_per_bin = sample_rate / (2 * (bins - 1)) as f64;
        let top = hz_to_mel(top_hz);
        let edges: Vec<f64> =
            (0..BANDS + 2).map(|i| mel_to_hz(top * i as f64 / (BANDS + 1) as f64)).collect();
        let bands = edges
            .windows(3)
            .map(|edge| Band::triangle(edge[0], edge[1], edge[2], hz_per_bin, bins))
            .collect();
        Self { bands }
    }

    /// Power per band of one frame of magnitudes.
    pub(crate) fn power<'out>(
        &self,
        magnitudes: &[f32],
        power: impl IntoIterator<Item = &'out mut f32>,
    ) {
        for (band, power) in self.bands.iter().zip(power) {
            *power = band
                .weights
                .iter()
                .zip(&magnitudes[band.first_bin..])
                .map(|(weight, magnitude)| weight * (magnitude * magnitude))
                .sum();
        }
    }
}

impl Band {
    fn triangle(low: f64, middle: f64, high: f64, hz_per_bin: f64, bins: usize) -> Self {
        let area = 2.0 / (high - low);
        let weight = |bin: usize| {
            let hz = bin as f64 * hz_per_bin;
            let rise = (hz - low) / (middle - low);
            let fall = (high - hz) / (high - middle);
            (rise.min(fall).max(0.0) * area) as f32
        };
        let first_bin = (0..bins).find(|&bin| weight(bin) > 0.0).unwrap_or(0);
        let weights = (first_bin..bins).map(weight).take_while(|&weight| weight > 0.0).collect();
        Self { first_bin, weights }
    }
}

const LINEAR_HZ_PER_MEL: f64 = 200.0 / 3.0;
const LOG_START_HZ: f64 = 1_000.0;
const LOG_START_MEL: f64 = 15.0;

fn log_mels_per_neper() -> f64 {
    27.0 / 6.4_f64.ln()
}

fn hz_to_mel(hz: f64) -> f64 {
    if hz < LOG_START_HZ {
        hz / LINEAR_HZ_PER_MEL
    } else {
        LOG_START_MEL + log_mels_per_neper() * (hz / LOG_START_HZ).ln()
    }
}

fn mel_to_hz(mel: f64) -> f64 {
    if mel < LOG_START_MEL {
        mel * LINEAR_HZ_PER_MEL
    } else {
        LOG_START_HZ * ((mel - LOG_START_MEL) / log_mels_per_neper()).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mel_scale_is_its_own_inverse_and_slaney() {
        for hz in [0.0, 440.0, 999.0, 1_000.0, 6_400.0, 15_360.0] {
            assert!((mel_to_hz(hz_to_mel(hz)) - hz).abs() < 1e-9 * hz.max(1.0));
        }
        assert!((hz_to_mel(6_400.0) - 42.0).abs() < 1e-12);
    }

    #[test]
    fn a_flat_spectrum_gives_one_over_the_bin_width_in_wide_bands() {
        let bank = MelBank::new(30_720.0, 1_025, 15_360.0);
        let mut power = [0.0; BANDS];
        bank.power(&[1.0; 1_025], &mut power);
        // Area 1 sampled every 15 Hz; the top bands are hundreds of Hz wide.
        for band in &power[100..] {
            assert!((band * 15.0 - 1.0).abs() < 0.01, "{band}");
        }
    }

    #[test]
    fn each_bin_weight_follows_the_formula() {
        let bank = MelBank::new(3_840.0, 1_025, 1_920.0);
        let top = 15.0 + 27.0 * (1.92_f64).ln() / 6.4_f64.ln();
        let edge = |i: usize| mel_to_hz(top * i as f64 / 129.0);
        for band in [0, 50, 127] {
            let (low, middle, high) = (edge(band), edge(band + 1), edge(band + 2));
            for bin in 0..1_025 {
                let hz = bin as f64 * 1.875;
                let (rise, fall) = ((hz - low) / (middle - low), (high - hz) / (high - middle));
                let expected = rise.min(fall).max(0.0) * 2.0 / (high - low);
                let mut impulse = vec![0.0; 1_025];
                impulse[bin] = 1.0;
                let mut power = [0.0; BANDS];
                bank.power(&impulse, &mut power);
                assert!((f64::from(power[band]) - expected).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn bands_above_the_spectrum_are_empty() {
        let bank = MelBank::new(3_840.0, 1_025, 11_025.0);
        let mut power = [f32::NAN; BANDS];
        bank.power(&[1.0; 1_025], &mut power);
        assert!(power[63] > 0.0);
        assert!(power[64..].iter().all(|&band| band == 0.0));
    }
}
