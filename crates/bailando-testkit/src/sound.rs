//! Synthetic sound.

/// Returns a reproducible sequence of 32 random bits each.
fn generator() -> impl FnMut() -> u32 {
    let mut state = 1_u32;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state
    }
}

/// Returns white noise at full scale.
#[must_use]
pub fn noise(samples: usize) -> Vec<f32> {
    let mut next = generator();
    let sample = |_| (next() >> 8) as f32 / 8_388_608.0 - 1.0;
    (0..samples).map(sample).collect()
}

/// Returns 16-bit samples at `rate` Hz with a click every `period_s` seconds from `first_s` on;
/// silence without a period.
#[must_use]
pub fn clicks(seconds: f64, rate: u32, first_s: f64, period_s: Option<f64>) -> Vec<i16> {
    let mut next = generator();
    let rate = f64::from(rate);
    let sample = |n: usize| {
        let noise = f64::from(next() >> 16) / 32_768.0 - 1.0;
        let since = period_s.map(|period| (n as f64 / rate - first_s).rem_euclid(period));
        let level = since.map_or(0.0, |since| (-since * 60.0).exp() * 0.6);
        (noise * level * 32_767.0) as i16
    };
    (0..(seconds * rate) as usize).map(sample).collect()
}
