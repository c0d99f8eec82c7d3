//! A convolution as matrix products: which input frames a row of output sees, and which part of
//! the kernel each of them meets.

use std::ops::Range;

/// How a convolution moves along time (ARCHITECTURE section 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Kernel 3 with this dilation and padding.
    Dilated(usize),
    /// Kernel 1.
    Pointwise,
    /// Kernel 4, stride 2, padding 1.
    Halving,
    /// The transpose of that.
    Doubling,
}

/// A convolution's plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Convolution {
    /// How it moves.
    pub kind: Kind,
    /// Whether the input goes through a rectifier first.
    pub rectified: bool,
    /// Channels of the input.
    pub inputs: usize,
    /// Channels of the output.
    pub outputs: usize,
}

/// One matrix product: columns of the lowered input times rows of the kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Product {
    /// Which of the frames side by side.
    pub(super) frames: Range<usize>,
    /// Part of the kernel that each of them meets.
    pub(super) taps: Vec<usize>,
    /// Which output frame of the row it adds to.
    pub(super) output: usize,
}

impl Convolution {
    /// Whether every frame is mapped alone.
    pub(super) fn is_linear(self) -> bool {
        self.kind == Kind::Pointwise && !self.rectified
    }

    /// Frames side by side in a row of the lowered input.
    pub(super) fn frames(self) -> usize {
        match self.kind {
            Kind::Dilated(_) | Kind::Doubling => 3,
            Kind::Pointwise => 1,
            Kind::Halving => 4,
        }
    }

    /// Rows of the lowered input for `time` frames.
    pub(super) fn rows(self, time: usize) -> usize {
        match self.kind {
            Kind::Halving => time / 2,
            _ => time,
        }
    }

    /// Output frames of a row.
    pub(super) fn outputs_per_row(self) -> usize {
        match self.kind {
            Kind::Doubling => 2,
            _ => 1,
        }
    }

    /// The input frame at place `frame` of `row`, if it lies in `0..time`.
    pub(super) fn source(self, row: usize, frame: usize, time: usize) -> Option<usize> {
        let place = match self.kind {
            Kind::Dilated(dilation) => (row + frame * dilation).checked_sub(dilation),
            Kind::Pointwise => Some(row),
            Kind::Halving => (2 * row + frame).checked_sub(1),
            Kind::Doubling => (row + frame).checked_sub(1),
        };
        place.filter(|&place| place < time)
    }

    /// The products that make a row of output.
    pub(super) fn products(self) -> Vec<Product> {
        let whole =
            |frames: usize| Product { frames: 0..frames, taps: (0..frames).collect(), output: 0 };
        match self.kind {
            // Output `2i` is tap 3 of frame `i - 1` and tap 1 of frame `i`; output `2i + 1` is tap
            // 2 of frame `i` and tap 0 of frame `i + 1`.
            Kind::Doubling => vec![
                Product { frames: 0..2, taps: vec![3, 1], output: 0 },
                Product { frames: 1..3, taps: vec![2, 0], output: 1 },
            ],
            _ => vec![whole(self.frames())],
        }
    }

    /// Length of the kernel.
    pub(super) fn kernel(self) -> usize {
        match self.kind {
            Kind::Dilated(_) => 3,
            Kind::Pointwise => 1,
            Kind::Halving | Kind::Doubling => 4,
        }
    }
}
