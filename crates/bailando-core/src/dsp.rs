//! Vectorised sums, shared by resampling and features.

/// Runs `work` with the widest vector instructions that this machine has.
///
/// All code inlined into `work` is compiled for each instruction set, and the program picks one
/// when it runs. The results are the same bit for bit: sums keep their order, and products are
/// rounded before they are added.
///
/// ```
/// use bailando_core::dsp::vectorised;
///
/// let mut samples = [1.0_f32, -2.0, 3.0];
/// vectorised(|| samples.iter_mut().for_each(|sample| *sample *= 0.5));
/// assert_eq!(samples, [0.5, -1.0, 1.5]);
/// ```
#[inline(always)]
pub fn vectorised<T>(work: impl FnOnce() -> T) -> T {
    pulp::Arch::new().dispatch(work)
}

/// Products that [`dot`] sums side by side.
pub const LANES: usize = 32;

/// Returns the modified Bessel function of the first kind and order zero, by its power series.
pub fn bessel_i0(x: f64) -> f64 {
    let quarter = x * x / 4.0;
    let (mut sum, mut term, mut k) = (1.0, 1.0, 1.0);
    while term > 1e-17 * sum {
        term *= quarter / (k * k);
        sum += term;
        k += 1.0;
    }
    sum
}

/// Returns the sum of products over the shorter length, in independent lanes so that it vectorises.
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    vectorised(
        #[inline(always)]
        || dot_inlined(a, b),
    )
}

/// Slices that [`dots`] takes together.
pub const TOGETHER: usize = 4;

/// Returns [`dot`] of `a` with each of the others, all of at least its length, bit for bit: `a` is
/// read once for all of them.
///
/// # Panics
/// If one of `others` is shorter than `a`.
pub fn dots(a: &[f32], others: [&[f32]; TOGETHER]) -> [f32; TOGETHER] {
    vectorised(
        #[inline(always)]
        || dots_inlined(a, others.map(|other| &other[..a.len()])),
    )
}

#[inline(always)]
fn dots_inlined(a: &[f32], others: [&[f32]; TOGETHER]) -> [f32; TOGETHER] {
    /// Products side by side here: all sums fit into the registers.
    const SIDE: usize = 8;
    let (a_lanes, a_rest) = a.as_chunks::<LANES>();
    let others = others.map(<[f32]>::as_chunks::<LANES>);
    let mut sums = [[0.0_f32; LANES]; TOGETHER];
    for part in 0..LANES / SIDE {
        let mut parts = [[0.0_f32; SIDE]; TOGETHER];
        for (index, a) in a_lanes.iter().enumerate() {
            let a = &a.as_chunks::<SIDE>().0[part];
            for (sums, other) in parts.iter_mut().zip(&others) {
                let b = &other.0[index].as_chunks::<SIDE>().0[part];
                for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
                    *sum += a * b;
                }
            }
        }
        for (sums, parts) in sums.iter_mut().zip(parts) {
            sums.as_chunks_mut::<SIDE>().0[part] = parts;
        }
    }
    let mut totals = [0.0_f32; TOGETHER];
    for lane in 0..LANES {
        for (total, sums) in totals.iter_mut().zip(&sums) {
            *total += sums[lane];
        }
    }
    let mut rests = [0.0_f32; TOGETHER];
    for (index, a) in a_rest.iter().enumerate() {
        for (rest, other) in rests.iter_mut().zip(&others) {
            *rest += a * other.1[index];
        }
    }
    std::array::from_fn(|index| totals[index] + rests[index])
}

#[inline(always)]
fn dot_inlined(a: &[f32], b: &[f32]) -> f32 {
    let length = a.len().min(b.len());
    let (a_lanes, a_rest) = a[..length].as_chunks::<LANES>();
    let (b_lanes, b_rest) = b[..length].as_chunks::<LANES>();
    let mut sums = [0.0_f32; LANES];
    for (a, b) in a_lanes.iter().zip(b_lanes) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bessel_matches_known_values() {
        assert_eq!(bessel_i0(0.0), 1.0);
        assert!((bessel_i0(1.0) - 1.266_065_877_752_008_4).abs() < 1e-15);
        assert!((bessel_i0(10.0) / 2_815.716_628_466_254 - 1.0).abs() < 1e-14);
    }

    #[test]
    fn products_are_summed_over_the_shorter_length() {
        let a: Vec<f32> = (0..53).map(|i| (i as f32 * 0.7).sin()).collect();
        let b: Vec<f32> = (0..61).map(|i| (i as f32 * 1.1).cos()).collect();
        for length in [0, 1, 15, 16, 17, 32, 53] {
            let direct: f32 = a[..length].iter().zip(&b).map(|(a, b)| a * b).sum();
            assert!((dot(&a[..length], &b) - direct).abs() < 1e-5, "{length}");
            assert_eq!(dot(&a[..length], &b), dot(&b, &a[..length]));
            let several = [0, 3, 8, 5].map(|start| &b[start..]);
            let together = dots(&a[..length.min(53)], several);
            assert_eq!(together, several.map(|b| dot(&a[..length], b)));
        }
    }
}
