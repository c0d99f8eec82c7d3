//! Twelve pitch classes from constant-Q magnitudes (FEATURES section 7).

use crate::tuning::BINS_PER_OCTAVE;

/// Pitch classes, C first.
pub(crate) const CLASSES: usize = 12;

const BINS_PER_CLASS: usize = BINS_PER_OCTAVE / CLASSES;

/// Writes the energy per pitch class of one frame, relative to the strongest; zeros without energy.
pub(crate) fn frame<'out>(
    cqt: impl IntoIterator<Item = &'out f32>,
    chroma: impl IntoIterator<Item = &'out mut f32>,
) {
    let mut sums = [0.0_f32; CLASSES];
    for (bin, magnitude) in cqt.into_iter().enumerate() {
        // A class owns its own bin and one on either side.
        sums[(bin + 1) % BINS_PER_OCTAVE / BINS_PER_CLASS] += magnitude;
    }
    let strongest = sums.iter().copied().fold(0.0, f32::max);
    let is_silent = strongest < f32::MIN_POSITIVE;
    let scale = if is_silent { 1.0 } else { strongest };
    for (class, sum) in chroma.into_iter().zip(sums) {
        *class = sum / scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_and_octaves_count_for_the_same_class() {
        let mut cqt = [0.0; 180];
        // C: bin 0, the one above, and the one below in the next octave; G in the second octave.
        for bin in [0, 1, 35, 36] {
            cqt[bin] = 0.5;
        }
        cqt[36 + 21] = 1.0;
        let mut chroma = [9.0; CLASSES];
        frame(&cqt, &mut chroma);
        let mut expected = [0.0; CLASSES];
        expected[0] = 1.0;
        expected[7] = 0.5;
        assert_eq!(chroma, expected);
    }

    #[test]
    fn silence_stays_zero() {
        let mut chroma = [9.0; CLASSES];
        frame(&[0.0; 180], &mut chroma);
        assert_eq!(chroma, [0.0; CLASSES]);
    }
}
