//! Real transforms planned once with their buffers, in f64 as the reference computes them.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;

/// A transform of `n` real samples to `n / 2 + 1` bins.
pub(crate) struct ForwardFft {
    plan: Arc<dyn RealToComplex<f64>>,
    input: Vec<f64>,
    output: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl ForwardFft {
    pub(crate) fn new(n: usize) -> Self {
        let plan = RealFftPlanner::new().plan_fft_forward(n);
        Self {
            input: plan.make_input_vec(),
            output: plan.make_output_vec(),
            scratch: plan.make_scratch_vec(),
            plan,
        }
    }

    /// The samples to transform; all must be set before every [`ForwardFft::run`].
    pub(crate) fn input(&mut self) -> &mut [f64] {
        &mut self.input
    }

    #[expect(clippy::expect_used, reason = "the plan made the buffers to its own sizes")]
    pub(crate) fn run(&mut self) -> &[Complex<f64>] {
        self.plan
            .process_with_scratch(&mut self.input, &mut self.output, &mut self.scratch)
            .expect("buffers of the planned sizes");
        &self.output
    }
}

/// A transform of `n / 2 + 1` bins to `n` real samples, without the factor `1 / n`.
pub(crate) struct InverseFft {
    plan: Arc<dyn ComplexToReal<f64>>,
    input: Vec<Complex<f64>>,
    output: Vec<f64>,
    scratch: Vec<Complex<f64>>,
}

impl InverseFft {
    pub(crate) fn new(n: usize) -> Self {
        let plan = RealFftPlanner::new().plan_fft_inverse(n);
        Self {
            input: plan.make_input_vec(),
            output: plan.make_output_vec(),
            scratch: plan.make_scratch_vec(),
            plan,
        }
    }

    /// The bins to transform; all must be set before every [`InverseFft::run`].
    pub(crate) fn input(&mut self) -> &mut [Complex<f64>] {
        &mut self.input
    }

    #[expect(clippy::expect_used, reason = "the plan made the buffers to its own sizes")]
    pub(crate) fn run(&mut self) -> &[f64] {
        // A real signal has real first and last bins; the plan insists on exact zeros.
        let last = self.input.len() - 1;
        self.input[0].im = 0.0;
        if self.output.len().is_multiple_of(2) {
            self.input[last].im = 0.0;
        }
        self.plan
            .process_with_scratch(&mut self.input, &mut self.output, &mut self.scratch)
            .expect("buffers of the planned sizes");
        &self.output
    }
}
