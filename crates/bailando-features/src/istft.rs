//! Inverse transform of a stream of frames by overlap-add (FEATURES section 4).

use std::ops::Range;

use rustfft::num_complex::Complex;

use crate::{
    fft::InverseFft,
    layout::HOP,
    stft::{FRAME, hann_periodic},
};

const OVERLAP: usize = FRAME / HOP;

/// Rebuilder of a signal from the frames of [`crate::stft::Stft::hann`], pushed in order.
pub(crate) struct OverlapAdd {
    inverse: InverseFft,
    window: Vec<f64>,
    /// Sum of the squared windows where all frames overlap, one hop long.
    squares: Vec<f64>,
    // The last FRAME samples that later frames still add to.
    pending: Vec<f64>,
}

/// A frame's place among all frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameOf {
    pub(crate) index: usize,
    pub(crate) count: usize,
}

impl OverlapAdd {
    pub(crate) fn new() -> Self {
        let window = hann_periodic(FRAME);
        Self {
            inverse: InverseFft::new(FRAME),
            squares: (0..HOP).map(|offset| squared_sum(&window, offset, 0..OVERLAP)).collect(),
            window,
            pending: vec![0.0; FRAME],
        }
    }

    /// Adds one frame and writes the samples that it completes into `signal`, the whole output.
    pub(crate) fn push(&mut self, spectrum: &[Complex<f32>], frame: FrameOf, signal: &mut [f32]) {
        if frame.index == 0 {
            self.pending.fill(0.0);
        }
        for (bin, &stored) in self.inverse.input().iter_mut().zip(spectrum) {
            *bin = Complex::new(f64::from(stored.re), f64::from(stored.im));
        }
        let samples = self.inverse.run();
        for ((sum, &sample), &weight) in self.pending.iter_mut().zip(samples).zip(&self.window) {
            *sum += sample * weight / FRAME as f64;
        }
        self.emit(frame.index, frame.count, signal);
        if frame.index + 1 == frame.count {
            for segment in frame.count..frame.count + OVERLAP - 1 {
                self.emit(segment, frame.count, signal);
            }
        }
    }

    /// Writes the first pending hop, which is segment `segment` of the padded signal.
    fn emit(&mut self, segment: usize, frames: usize, signal: &mut [f32]) {
        // The first FRAME / 2 samples are padding.
        let position = (segment * HOP).checked_sub(FRAME / 2);
        let output = position.and_then(|position| signal.get_mut(position..));
        let output = output.unwrap_or_default().iter_mut();
        let sums = &self.pending[..HOP];
        if segment + 1 >= OVERLAP && segment < frames {
            for ((output, sum), weight) in output.zip(sums).zip(&self.squares) {
                *output = (sum / weight) as f32;
            }
        } else {
            let first = (segment + 1).saturating_sub(frames);
            let quarters = first..OVERLAP.min(segment + 1);
            for (offset, (output, &sum)) in output.zip(sums).enumerate() {
                let weight = squared_sum(&self.window, offset, quarters.clone());
                *output = if weight > f64::from(f32::MIN_POSITIVE) {
                    (sum / weight) as f32
                } else {
                    sum as f32
                };
            }
        }
        self.pending.copy_within(HOP.., 0);
        self.pending[FRAME - HOP..].fill(0.0);
    }
}

/// Sum of the squared window at `offset` samples into each of its `quarters` (hops from its start).
fn squared_sum(window: &[f64], offset: usize, quarters: Range<usize>) -> f64 {
    quarters.map(|quarter| window[quarter * HOP + offset].powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        padding::Padding,
        stft::{BINS, Stft},
    };

    #[test]
    fn frames_of_a_signal_give_the_signal_back() {
        for samples in [1_024, 1_300, 4_096, 5_000] {
            let signal: Vec<f32> = (0..samples).map(|i| (i as f32 * 0.71).sin()).collect();
            let count = 1 + samples / HOP;
            let mut stft = Stft::hann(Padding::Zeros);
            let mut spectrum = vec![Complex::default(); BINS];
            let mut back = vec![0.0; samples];
            let mut overlap_add = OverlapAdd::new();
            for index in 0..count {
                stft.frame(&signal, index * HOP, &mut spectrum);
                overlap_add.push(&spectrum, FrameOf { index, count }, &mut back);
            }
            for (sample, (got, expected)) in back.iter().zip(&signal).enumerate() {
                assert!((got - expected).abs() < 2e-6, "{samples}: sample {sample}");
            }
        }
    }
}
