//! Power to decibels with a floor below the clip's maximum (FEATURES section 3).

use ndarray::Array2;

const SMALLEST_POWER: f32 = 1e-10;
const RANGE_DB: f32 = 80.0;

/// The power at 0 dB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reference {
    /// The largest value of the clip.
    Maximum,
    /// A power of 1.
    One,
}

/// Replaces the powers of a whole clip by decibels; nothing lies more than 80 dB below the maximum.
pub(crate) fn to_decibels(powers: &mut Array2<f32>, reference: Reference) {
    let maximum = powers.iter().copied().fold(0.0, f32::max);
    let offset = match reference {
        Reference::Maximum => 10.0 * f64::from(maximum.max(SMALLEST_POWER)).log10(),
        Reference::One => 0.0,
    };
    let decibels =
        |power: f32| (10.0 * f64::from(power.max(SMALLEST_POWER)).log10() - offset) as f32;
    let floor = decibels(maximum) - RANGE_DB;
    powers.mapv_inplace(|power| decibels(power).max(floor));
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn decibels_are_relative_to_the_maximum_and_floored() {
        let mut values = array![[100.0, 1.0, 1e-7, 0.0]];
        to_decibels(&mut values, Reference::Maximum);
        assert_eq!(values, array![[0.0, -20.0, -80.0, -80.0]]);
        let mut values = array![[100.0, 1.0, 1e-7, 0.0]];
        to_decibels(&mut values, Reference::One);
        assert_eq!(values, array![[20.0, 0.0, -60.0, -60.0]]);
    }

    #[test]
    fn silence_is_the_reference_itself() {
        let mut values = array![[0.0, 0.0, 0.0]];
        to_decibels(&mut values, Reference::Maximum);
        assert_eq!(values, array![[0.0, 0.0, 0.0]]);
        let mut values = array![[0.0, 0.0, 0.0]];
        to_decibels(&mut values, Reference::One);
        assert_eq!(values, array![[-100.0, -100.0, -100.0]]);
    }
}
