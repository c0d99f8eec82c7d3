//! Numbers with a fixed count of decimals.
//!
//! `{:.4}` of a double finds its exact digits first, and then goes through the library's padding,
//! which a file of a hundred thousand rounded numbers does not need.

use std::fmt::{self, Write};

/// Decimals of the largest power of ten that is used.
const MOST_DECIMALS: usize = 9;
/// Whole numbers below it are exact in a double.
const EXACT: f64 = (1_u64 << f64::MANTISSA_DIGITS) as f64;
/// 16 digits of an exact number, at least one before the point, the point and a sign.
const MOST_BYTES: usize = 20;

/// Appends `value` rounded to so many decimals, 0 without a sign. Halves are rounded away from
/// zero, where a double can hold them.
pub(crate) fn push_decimal(text: &mut String, value: f64, decimals: usize) -> fmt::Result {
    let power = 10_u64.pow(decimals.clamp(1, MOST_DECIMALS) as u32);
    let scaled = (value * power as f64).round();
    if !(1..=MOST_DECIMALS).contains(&decimals) || scaled.is_nan() || scaled.abs() >= EXACT {
        return write!(text, "{value:.decimals$}");
    }
    // From the last digit to the first.
    let mut bytes = [b'0'; MOST_BYTES];
    let mut first = MOST_BYTES;
    let mut push = |byte: u8| {
        first -= 1;
        bytes[first] = byte;
    };
    let mut rest = scaled.abs() as u64;
    for _ in 0..decimals {
        push(b'0' + (rest % 10) as u8);
        rest /= 10;
    }
    push(b'.');
    loop {
        push(b'0' + (rest % 10) as u8);
        rest /= 10;
        if rest == 0 {
            break;
        }
    }
    if scaled < 0.0 {
        push(b'-');
    }
    text.push_str(str::from_utf8(&bytes[first..]).map_err(|_| fmt::Error)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn text(value: f64, decimals: usize) -> String {
        let mut text = String::new();
        push_decimal(&mut text, value, decimals).unwrap();
        text
    }

    proptest! {
        #[test]
        fn numbers_are_written_as_the_library_would(
            value in -4_000.0..4_000.0_f64,
            decimals in 1_usize..=6,
        ) {
            let power = 10.0_f64.powi(decimals as i32);
            // Near a half the product decides, which is rounded itself.
            prop_assume!(((value * power).fract().abs() - 0.5).abs() > 1e-6);
            prop_assume!((value * power).round() != 0.0);
            prop_assert_eq!(text(value, decimals), format!("{value:.decimals$}"));
        }
    }

    #[test]
    fn signs_zeros_and_extremes() {
        let cases = [
            (0.0, 4, "0.0000"),
            (-0.0, 4, "0.0000"),
            (-0.000_04, 4, "0.0000"),
            (-0.000_06, 4, "-0.0001"),
            (0.999_96, 4, "1.0000"),
            (-12.5, 1, "-12.5"),
            (-1_234_567.890_625, 9, "-1234567.890625000"),
            (3.05, 6, "3.050000"),
            (7.0, 0, "7"),
            (1e17, 2, "100000000000000000.00"),
            (f64::NAN, 2, "NaN"),
            (f64::NEG_INFINITY, 2, "-inf"),
        ];
        for (value, decimals, wanted) in cases {
            assert_eq!(text(value, decimals), wanted);
        }
    }
}
