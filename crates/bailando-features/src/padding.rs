//! Values outside a signal or an axis.

/// The samples outside a signal, for the frames at both ends (FEATURES sections 2 and 11.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Padding {
    /// Silence.
    Zeros,
    /// The signal mirrored at its first and last sample, which are not repeated.
    Reflect,
}

impl Padding {
    /// Fills `frame` with the samples from `start` on, which may lie outside `signal`.
    pub(crate) fn fill(self, signal: &[f32], start: isize, frame: &mut [f32]) {
        let inside =
            usize::try_from(start).ok().and_then(|first| signal.get(first..first + frame.len()));
        if let Some(samples) = inside {
            frame.copy_from_slice(samples);
            return;
        }
        for (sample, index) in frame.iter_mut().zip(start..) {
            *sample = self.sample(signal, index);
        }
    }

    fn sample(self, signal: &[f32], index: isize) -> f32 {
        let index = match self {
            Self::Zeros => usize::try_from(index).ok(),
            Self::Reflect => Some(mirror_at_samples(index, signal.len())),
        };
        index.and_then(|index| signal.get(index)).copied().unwrap_or_default()
    }
}

/// Index after mirroring at the first and last of `len` samples (`x2 x1 | x0 x1 x2`).
fn mirror_at_samples(index: isize, len: usize) -> usize {
    if len < 2 {
        return 0;
    }
    let period = 2 * (len - 1);
    let folded = index.rem_euclid(period as isize) as usize;
    folded.min(period - folded)
}

/// Index after mirroring between samples (`x1 x0 | x0 x1`), period `2 len`; `len` is not 0.
pub(crate) fn mirror_between_samples(index: isize, len: usize) -> usize {
    let folded = index.rem_euclid(2 * len as isize) as usize;
    folded.min(2 * len - 1 - folded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrors_repeat_beyond_one_period() {
        let got: Vec<_> = (-5..8).map(|i| mirror_at_samples(i, 3)).collect();
        assert_eq!(got, [1, 0, 1, 2, 1, 0, 1, 2, 1, 0, 1, 2, 1]);
        let got: Vec<_> = (-4..7).map(|i| mirror_between_samples(i, 3)).collect();
        assert_eq!(got, [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0]);
        assert_eq!(mirror_at_samples(-7, 1), 0);
        assert_eq!(mirror_between_samples(-7, 1), 0);
    }

    #[test]
    fn frames_over_the_edges_are_padded() {
        let signal = [1.0, 2.0, 3.0, 4.0];
        let mut frame = [9.0; 3];
        Padding::Zeros.fill(&signal, -2, &mut frame);
        assert_eq!(frame, [0.0, 0.0, 1.0]);
        Padding::Reflect.fill(&signal, -2, &mut frame);
        assert_eq!(frame, [3.0, 2.0, 1.0]);
        Padding::Reflect.fill(&signal, 3, &mut frame);
        assert_eq!(frame, [4.0, 3.0, 2.0]);
        Padding::Zeros.fill(&signal, 1, &mut frame);
        assert_eq!(frame, [2.0, 3.0, 4.0]);
        Padding::Zeros.fill(&signal, 3, &mut frame);
        assert_eq!(frame, [4.0, 0.0, 0.0]);
    }
}
