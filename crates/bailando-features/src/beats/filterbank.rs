//! Triangles over the bins of a spectrum, 24 an octave (BEATS, spectrogram 3).

/// Bands of the bank.
pub(super) const BANDS: usize = 136;
/// Bins that the bank reads.
pub(super) const BINS: usize = 705;

/// Corners of the lowest bands, one bin apart.
const FIRST_CORNERS: std::ops::RangeInclusive<usize> = 2..=36;
/// The other corners: band `k` rises from corner `k` to `k + 1` and falls to `k + 2`.
const FURTHER_CORNERS: [usize; BANDS + 2 - 35] = [
    38, 39, 40, 41, 42, 43, 45, 46, 47, 49, 50, 52, 53, 55, 56, 58, 60, 61, 63, 65, 67, 69, 71, 73,
    75, 77, 80, 82, 84, 87, 89, 92, 95, 97, 100, 103, 106, 109, 113, 116, 119, 123, 126, 130, 134,
    138, 142, 146, 150, 155, 159, 164, 169, 174, 179, 184, 189, 195, 201, 206, 212, 219, 225, 232,
    238, 245, 253, 260, 268, 276, 284, 292, 300, 309, 318, 328, 337, 347, 357, 368, 379, 390, 401,
    413, 425, 437, 450, 463, 477, 491, 505, 520, 535, 551, 567, 584, 601, 619, 637, 655, 675, 694,
    704,
];

/// The triangles, each of sum 1.
#[derive(Debug)]
pub(super) struct FilterBank {
    bands: Vec<Band>,
}

#[derive(Debug)]
struct Band {
    /// Bin of the first weight.
    first: usize,
    weights: Vec<f32>,
}

impl FilterBank {
    pub(super) fn new() -> Self {
        let corners: Vec<usize> = FIRST_CORNERS.chain(FURTHER_CORNERS).collect();
        let bands = corners.windows(3).map(|corners| match *corners {
            [first, middle, end] => Band::new(first, middle, end),
            _ => unreachable!("windows have three corners"),
        });
        Self { bands: bands.collect() }
    }

    /// Writes the bands `[136]` of a spectrum's magnitudes `[705]`.
    pub(super) fn apply(&self, magnitudes: &[f32], bands: &mut [f32]) {
        for (value, band) in bands.iter_mut().zip(&self.bands) {
            let bins = magnitudes.iter().skip(band.first);
            *value = band.weights.iter().zip(bins).map(|(weight, bin)| weight * bin).sum();
        }
    }
}

impl Band {
    fn new(first: usize, middle: usize, end: usize) -> Self {
        let (rise, fall) = ((middle - first) as f64, (end - middle) as f64);
        let rising = (first..middle).map(|bin| (bin - first) as f64 / rise);
        let falling = (middle..end).map(|bin| 1.0 - (bin - middle) as f64 / fall);
        let weights: Vec<f64> = rising.chain(falling).collect();
        let sum: f64 = weights.iter().sum();
        let weights = weights.into_iter().map(|weight| (weight / sum) as f32).collect();
        Self { first, weights }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_are_triangles_of_sum_1_around_their_middle_corner() {
        let bank = FilterBank::new();
        assert_eq!(bank.bands.len(), BANDS);
        let mut bands = [0.0; BANDS];
        bank.apply(&[2.0; BINS], &mut bands);
        assert!(bands.iter().all(|band| (band - 2.0).abs() < 1e-6));
        // Band 132 rises over bins 619..637 and falls to 655.
        let at = |bin: usize| {
            let mut magnitudes = [0.0; BINS];
            magnitudes[bin] = 18.0;
            let mut bands = [0.0; BANDS];
            bank.apply(&magnitudes, &mut bands);
            bands
        };
        assert_eq!(at(619)[132], 0.0);
        assert!((at(637)[132] - 1.0).abs() < 1e-6 && at(637)[133] == 0.0);
        assert!((at(646)[132] - 0.5).abs() < 1e-6);
        assert_eq!(at(1), [0.0; BANDS]);
    }
}
