//! Streaming sample-rate conversion (FEATURES section 1): a zero-phase polyphase Kaiser-windowed
//! sinc that reproduces soxr "HQ" to about 1e-4 of full scale, planned once per pair of rates.

use std::{array, sync::Arc};

use bailando_core::dsp::TOGETHER;

use crate::kernel::{Kernel, planned_kernel};

/// Streaming converter of one mono signal from one integer rate to another.
///
/// Output sample `m` sits at input time `m * from / to`; outside the signal is zero; `n` input
/// samples give `ceil(n * to / from)` output samples. Equal rates pass through bit for bit.
/// Memory is bounded by the filter (at most about 5 MiB), whatever the signal's length.
#[derive(Debug)]
pub struct Resampler {
    kernel: Option<Arc<Kernel>>,
    /// The rates divided by their greatest common divisor.
    from: u64,
    to: u64,
    /// Input that later outputs still need; its first sample has index `base` in the signal.
    history: Vec<f32>,
    base: i64,
    /// Input position of the next output: `index + phase / to`.
    index: i64,
    phase: u64,
    received: u64,
    produced: u64,
}

impl Resampler {
    /// Plans the conversion; both rates in Hz, at least 1 each (0 is taken as 1).
    #[must_use]
    pub fn new(from_hz: u32, to_hz: u32) -> Self {
        let (from, to) = (u64::from(from_hz.max(1)), u64::from(to_hz.max(1)));
        let divisor = gcd(from, to);
        let (from, to) = (from / divisor, to / divisor);
        let kernel = (from != to).then(|| planned_kernel(from, to));
        let mut planned = Self {
            kernel,
            from,
            to,
            history: Vec::new(),
            base: 0,
            index: 0,
            phase: 0,
            received: 0,
            produced: 0,
        };
        if let Some(kernel) = &planned.kernel {
            // Zeros in front of the signal, which the first outputs use.
            planned.history = vec![0.0; kernel.reach() - 1];
            planned.base = 1 - signed(kernel.reach());
        }
        planned
    }

    /// Takes `input` and appends every output that it completes to `output`.
    pub fn process(&mut self, input: &[f32], output: &mut Vec<f32>) {
        self.received += input.len() as u64;
        if self.kernel.is_none() {
            output.extend_from_slice(input);
            return;
        }
        self.history.extend_from_slice(input);
        self.produce(u64::MAX, output);
    }

    /// Ends the signal and appends the remaining outputs.
    pub fn finish(mut self, output: &mut Vec<f32>) {
        let Some(kernel) = &self.kernel else { return };
        let reach = kernel.reach();
        let total = (u128::from(self.received) * u128::from(self.to)).div_ceil(self.from.into());
        let total = u64::try_from(total).unwrap_or(u64::MAX);
        // One window of zeros completes every output that lies inside the signal.
        self.history.resize(self.history.len() + reach, 0.0);
        self.produce(total, output);
    }

    /// Appends outputs while their window is complete and fewer than `limit` were produced.
    fn produce(&mut self, limit: u64, output: &mut Vec<f32>) {
        let Some(kernel) = self.kernel.clone() else { return };
        while self.produce_periods(&kernel, limit, output) {}
        while self.produced < limit {
            let first = usize::try_from(self.index + 1 - signed(kernel.reach()) - self.base);
            let window =
                first.ok().and_then(|first| self.history.get(first..first + kernel.taps()));
            let Some(window) = window else { break };
            output.push(kernel.apply(self.phase, window));
            self.produced += 1;
            self.phase += self.from;
            self.index += (self.phase / self.to).cast_signed();
            self.phase %= self.to;
        }
        let unused = self.index + 1 - signed(kernel.reach()) - self.base;
        let unused = usize::try_from(unused).unwrap_or(0).min(self.history.len());
        self.history.drain(..unused);
        self.base += signed(unused);
    }

    /// Appends `to` outputs for each of the next [`TOGETHER`] times `from` inputs, where they are
    /// there. Outputs one period apart have the same phase.
    fn produce_periods(&mut self, kernel: &Kernel, limit: u64, output: &mut Vec<f32>) -> bool {
        let together = TOGETHER as u64;
        let complete = || {
            let made = self.to.checked_mul(together)?;
            let (period, span) = (self.from, self.from.checked_mul(together)?);
            let first =
                usize::try_from(self.index + 1 - signed(kernel.reach()) - self.base).ok()?;
            let inputs = self.history.get(first..)?;
            let enough = inputs.len() as u64 > span + kernel.taps() as u64;
            (enough && self.produced.checked_add(made)? <= limit).then_some((
                inputs,
                period as usize,
                self.to as usize,
            ))
        };
        let Some((inputs, period, outputs)) = complete() else { return false };
        let (mut phase, mut index, start) = (self.phase, 0, output.len());
        output.resize(start + outputs * TOGETHER, 0.0);
        for at in start..start + outputs {
            let windows = array::from_fn(|turn| {
                let first = index + turn * period;
                &inputs[first..first + kernel.taps()]
            });
            let Some(values) = kernel.apply_to(phase, windows) else {
                output.truncate(start);
                return false;
            };
            for (turn, value) in values.into_iter().enumerate() {
                output[at + turn * outputs] = value;
            }
            phase += self.from;
            index += (phase / self.to) as usize;
            phase %= self.to;
        }
        self.produced += self.to * together;
        self.index += signed(TOGETHER * period);
        true
    }
}

/// Converts a whole signal; see [`Resampler`].
#[must_use]
pub fn resample(signal: &[f32], from_hz: u32, to_hz: u32) -> Vec<f32> {
    let mut resampler = Resampler::new(from_hz, to_hz);
    let mut output = Vec::new();
    resampler.process(signal, &mut output);
    resampler.finish(&mut output);
    output
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Lengths here are bounded by the memory they occupy, far below `i64::MAX`.
fn signed(length: usize) -> i64 {
    length as i64
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::kernel::{MAX_TABLE, Shape};

    fn noise(n: usize) -> Vec<f32> {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        (0..n).map(|_| next()).collect()
    }

    fn sine(n: usize, hz: f64, rate: u32) -> Vec<f32> {
        (0..n).map(|i| (2.0 * PI * hz * i as f64 / f64::from(rate)).sin() as f32).collect()
    }

    /// FEATURES section 1, evaluated in f64 without tables.
    fn by_definition(signal: &[f32], from: u32, to: u32, m: usize) -> f64 {
        let ratio = f64::from(to) / f64::from(from);
        let shape = Shape::new(ratio);
        let position = m as f64 / ratio;
        signal.iter().enumerate().map(|(i, &x)| f64::from(x) * shape.at(i as f64 - position)).sum()
    }

    #[test]
    fn every_ratio_follows_the_definition_and_the_length_rule() {
        for (from, to, tolerance) in [
            (44_100, 3_840, 2e-6),
            (44_100, 30_720, 2e-6),
            (48_000, 30_720, 2e-6),
            (8_000, 30_720, 2e-6),
            (22_050, 30_720, 2e-6),
            (192_000, 3_840, 2e-6),
            // Too many phases for a table of their own: interpolated.
            (44_101, 3_840, 2e-5),
            (44_101, 30_720, 2e-5),
            (8_001, 30_720, 2e-5),
        ] {
            let signal = noise(6_001);
            let got = resample(&signal, from, to);
            let expected = (6_001_u64 * u64::from(to)).div_ceil(from.into());
            assert_eq!(got.len() as u64, expected, "{from} to {to}");
            for m in (0..got.len()).step_by(1 + got.len() / 40).chain([got.len() - 1]) {
                let wanted = by_definition(&signal, from, to, m);
                let error = (f64::from(got[m]) - wanted).abs();
                assert!(error < tolerance, "{from} to {to}, {m}: {error:e}");
            }
        }
    }

    #[test]
    fn pieces_give_what_the_whole_gives() {
        let signal = noise(20_000);
        let whole = resample(&signal, 44_100, 30_720);
        let mut resampler = Resampler::new(44_100, 30_720);
        let (mut pieces, mut rest, mut size) = (Vec::new(), signal.as_slice(), 0);
        while !rest.is_empty() {
            let (piece, next) = rest.split_at(size.min(rest.len()));
            resampler.process(piece, &mut pieces);
            rest = next;
            size = (size * 3 + 1) % 2_000;
        }
        resampler.finish(&mut pieces);
        assert_eq!(pieces, whole);
    }

    #[test]
    fn equal_rates_pass_bit_for_bit_and_nothing_stays_nothing() {
        let signal = noise(1_000);
        assert_eq!(resample(&signal, 3_840, 3_840), signal);
        assert!(resample(&[], 44_100, 3_840).is_empty());
        assert_eq!(resample(&[1.0], 44_100, 30_720).len(), 1);
    }

    /// Level of a sine after conversion, away from the ends.
    fn level(hz: f64, from: u32, to: u32) -> f64 {
        let output = resample(&sine(from as usize, hz, from), from, to);
        let middle = &output[output.len() / 4..output.len() * 3 / 4];
        let power: f64 = middle.iter().map(|&x| f64::from(x).powi(2)).sum();
        (2.0 * power / middle.len() as f64).sqrt()
    }

    #[test]
    fn flat_to_0_913_and_silent_from_the_lower_nyquist_frequency() {
        for (from, to) in [(44_100, 3_840), (44_100, 30_720), (32_000, 30_720)] {
            let nyquist = f64::from(to) / 2.0;
            for part in [0.1, 0.5, 0.9, 0.913] {
                let level = level(part * nyquist, from, to);
                assert!((level - 1.0).abs() < 1e-3, "{from} to {to}, {part}: {level}");
            }
            // f32 arithmetic leaves a floor near -130 dB.
            let level = level(1.001 * nyquist, from, to);
            assert!(level < 2e-6, "{from} to {to}: {level:e}");
        }
        // Upwards nothing may appear above the old Nyquist frequency, and nothing be lost below.
        let up = level(0.9 * 4_000.0, 8_000, 30_720);
        assert!((up - 1.0).abs() < 1e-3, "{up}");
    }

    #[test]
    fn memory_stays_small_for_odd_ratios() {
        for (from, to) in [(44_101, 3_840), (191_999, 3_840), (8_001, 30_720), (48_000, 3_840)] {
            let divisor = gcd(from, to);
            let kernel = Kernel::new(from / divisor, to / divisor);
            assert!(kernel.coefficients() <= MAX_TABLE, "{}", kernel.coefficients());
        }
    }
}
