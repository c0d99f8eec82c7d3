//! The resampler's filter: its shape (FEATURES section 1) and its table of phases.

use std::{
    f64::consts::PI,
    sync::{Arc, Mutex, PoisonError},
};

use bailando_core::dsp::{LANES, TOGETHER, bessel_i0, dot, dots};

/// Cut-off relative to the lower Nyquist frequency: flat to 0.913 of it, -120 dB from 1.0.
const CUTOFF: f64 = 0.95685;
/// soxr allows its passband to droop by up to 0.01 dB; for strong decimation it does, by 0.005 dB
/// from 0.7 to 0.9 of the Nyquist frequency. This share of a low-pass with a wide transition around
/// 0.8 has that droop. A fit to either golden file gives the same share to half a percent.
const DROOP: f64 = 6.12e-4;
/// Cut-off, half width and Kaiser beta of that low-pass.
const DROOPING: (f64, f64, f64) = (0.8, 12.0, 5.0);
/// Largest exact table in coefficients (4 MiB); above it phases are interpolated.
pub(crate) const MAX_TABLE: usize = 1 << 20;

/// Ratio of the rates below which soxr's filter is the longer one.
const STRONG_DECIMATION: f64 = 0.25;

/// Returns half width (in samples of the lower rate) and Kaiser beta for a ratio `to / from`
/// (FEATURES section 1).
fn window_of(ratio: f64) -> (f64, f64) {
    if ratio < STRONG_DECIMATION { (116.5, 16.76) } else { (107.7, 15.35) }
}

/// Returns the kernel of a reduced ratio. The last few are kept: planning takes as long as
/// converting several seconds of music, and nearly all uploads share two or three rates.
pub(crate) fn planned_kernel(from: u64, to: u64) -> Arc<Kernel> {
    const KEPT: usize = 8;
    static PLANNED: Mutex<Vec<(u64, u64, Arc<Kernel>)>> = Mutex::new(Vec::new());
    // The list is whole between any two statements, so a poisoned lock does no harm.
    let lock = || PLANNED.lock().unwrap_or_else(PoisonError::into_inner);
    let known = lock()
        .iter()
        .find(|entry| (entry.0, entry.1) == (from, to))
        .map(|entry| Arc::clone(&entry.2));
    known.unwrap_or_else(|| {
        let kernel = Arc::new(Kernel::new(from, to));
        let mut planned = lock();
        if planned.len() == KEPT {
            planned.remove(0);
        }
        planned.push((from, to, Arc::clone(&kernel)));
        kernel
    })
}

/// The filter's coefficients, one row per fractional position of an output between two inputs.
#[derive(Debug)]
pub(crate) struct Kernel {
    /// Inputs used on each side; a row has twice as many taps.
    reach: usize,
    rows: Vec<f32>,
    phases: u64,
    /// Rows per input sample where there are too many phases for one row each; 0: exact rows.
    interpolated: u16,
}

impl Kernel {
    pub(crate) fn new(from: u64, to: u64) -> Self {
        let ratio = to as f64 / from as f64;
        let shape = Shape::new(ratio);
        let reach = (shape.half / shape.scale).ceil() as usize;
        // The inner product then takes all taps in whole lanes.
        let reach = reach.next_multiple_of(LANES / 2);
        let exact = usize::try_from(to).is_ok_and(|to| to.saturating_mul(2 * reach) <= MAX_TABLE);
        // A linear step between rows errs by (pi * bandwidth / rows)^2 / 2 at most, below 5e-6.
        let interpolated = match (1024.0 * shape.scale) as u16 {
            _ if exact => 0,
            wanted => wanted.next_power_of_two().clamp(64, 1024),
        };
        let (rows, step) = if exact {
            (to, 1.0 / to as f64)
        } else {
            (u64::from(interpolated) + 1, 1.0 / f64::from(interpolated))
        };
        let coefficients = (0..rows)
            .flat_map(|row| {
                let fraction = row as f64 * step;
                let shape = &shape;
                (0..2 * reach).map(move |tap| {
                    let distance = tap as f64 + 1.0 - reach as f64 - fraction;
                    shape.at(distance) as f32
                })
            })
            .collect();
        Self { reach, rows: coefficients, phases: to, interpolated }
    }

    /// Inputs used on each side of an output.
    pub(crate) fn reach(&self) -> usize {
        self.reach
    }

    #[cfg(test)]
    pub(crate) fn coefficients(&self) -> usize {
        self.rows.len()
    }

    pub(crate) fn taps(&self) -> usize {
        2 * self.reach
    }

    /// Returns what [`Kernel::apply`] gives for several windows at the same phase, with one pass
    /// over the coefficients: the table is larger than a core's cache. `None` where phases are
    /// interpolated.
    pub(crate) fn apply_to(
        &self,
        phase: u64,
        windows: [&[f32]; TOGETHER],
    ) -> Option<[f32; TOGETHER]> {
        (self.interpolated == 0).then(|| dots(self.row(phase as usize), windows))
    }

    fn row(&self, index: usize) -> &[f32] {
        let taps = self.taps();
        &self.rows[index * taps..(index + 1) * taps]
    }

    /// Returns one output: `window` holds the inputs around it, `phase / phases` is its distance
    /// after the window's middle input.
    pub(crate) fn apply(&self, phase: u64, window: &[f32]) -> f32 {
        if self.interpolated == 0 {
            return dot(self.row(phase as usize), window);
        }
        let at = phase as f64 / self.phases as f64 * f64::from(self.interpolated);
        let (index, fraction) = (at as usize, at.fract() as f32);
        let (low, high) = (dot(self.row(index), window), dot(self.row(index + 1), window));
        low + fraction * (high - low)
    }
}

/// The continuous impulse response.
pub(crate) struct Shape {
    /// Samples of the lower rate per input sample.
    scale: f64,
    half: f64,
    steep: Lowpass,
    drooping: Option<Lowpass>,
}

impl Shape {
    pub(crate) fn new(ratio: f64) -> Self {
        let (half, beta) = window_of(ratio);
        let drooping = (ratio < STRONG_DECIMATION).then(|| {
            let (cutoff, half, beta) = DROOPING;
            Lowpass::new(cutoff, half, beta)
        });
        Self { scale: ratio.min(1.0), half, steep: Lowpass::new(CUTOFF, half, beta), drooping }
    }

    /// Returns the response times the gain, `distance` in input samples.
    pub(crate) fn at(&self, distance: f64) -> f64 {
        let u = distance * self.scale;
        let steep = self.steep.at(u);
        let response = match &self.drooping {
            Some(drooping) => steep + DROOP * (drooping.at(u) - steep),
            None => steep,
        };
        self.scale * response
    }
}

/// `fc sinc(fc u) kaiser(u / half)`, `u` in samples of the lower rate.
struct Lowpass {
    cutoff: f64,
    half: f64,
    beta: f64,
    peak: f64,
}

impl Lowpass {
    fn new(cutoff: f64, half: f64, beta: f64) -> Self {
        Self { cutoff, half, beta, peak: bessel_i0(beta) }
    }

    fn at(&self, u: f64) -> f64 {
        let inside = 1.0 - (u / self.half).powi(2);
        if inside <= 0.0 {
            return 0.0;
        }
        let window = bessel_i0(self.beta * inside.sqrt()) / self.peak;
        self.cutoff * sinc(self.cutoff * u) * window
    }
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) }
}
