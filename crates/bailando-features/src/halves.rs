//! The percussive part of a long signal, its halves side by side on two threads (FEATURES section
//! 4).

use std::thread;

use bailando_core::CancelToken;

use crate::{hpss::Separator, layout::HOP, median::WINDOW, padding::Padding, stft::FRAME};

/// Frames beyond its border that a half needs: those under the median along time, those whose
/// windows share samples with theirs, and those that the padding at a signal's end reaches.
const MARGIN: usize = WINDOW / 2 + 2 * (FRAME / HOP);
/// Samples below which a second thread is not worth its start.
const WORTH_A_THREAD: usize = 256 * HOP;

/// Two separators, whose result is that of one alone, bit for bit.
pub(crate) struct Halves {
    separators: [Separator; 2],
}

impl Halves {
    pub(crate) fn new(padding: Padding, silent_tail: bool) -> Self {
        Self { separators: [(); 2].map(|()| Separator::new(padding, silent_tail)) }
    }

    /// The separator for a signal that one thread works on.
    pub(crate) fn single(&mut self) -> &mut Separator {
        let [one, _] = &mut self.separators;
        one
    }

    /// Leaves the percussive part of `signal` in its place. Stops at the next frame once `cancel`
    /// is triggered: the result is then worthless.
    pub(crate) fn percussive(&mut self, signal: &mut [f32], cancel: &CancelToken) {
        let [one, other] = &mut self.separators;
        if signal.len() < WORTH_A_THREAD {
            one.split(signal, None, cancel, |_, _| {});
            return;
        }
        // Frames lie where they lay in the whole: the border is between two hops.
        let border = signal.len() / 2 / HOP * HOP;
        let margin = MARGIN * HOP;
        let mut first = signal[..border + margin].to_vec();
        let second = &mut signal[border - margin..];
        thread::scope(|scope| {
            scope.spawn(|| one.split(&mut first, None, cancel, |_, _| {}));
            other.split(second, None, cancel, |_, _| {});
        });
        signal[..border].copy_from_slice(&first[..border]);
    }
}

#[cfg(test)]
mod tests {
    use bailando_testkit::sound::noise;

    use super::*;

    #[test]
    fn halves_are_those_of_the_whole() {
        for padding in [Padding::Zeros, Padding::Reflect] {
            for samples in [WORTH_A_THREAD - 1, WORTH_A_THREAD, WORTH_A_THREAD + 45_001] {
                let silent_tail = padding == Padding::Reflect;
                let mut whole = noise(samples);
                let mut halves = whole.clone();
                let cancel = &CancelToken::new();
                let mut separator = Separator::new(padding, silent_tail);
                separator.split(&mut whole, None, cancel, |_, _| {});
                Halves::new(padding, silent_tail).percussive(&mut halves, cancel);
                assert_eq!(whole, halves, "{samples} samples");
            }
        }
    }

    #[test]
    fn both_halves_stop_when_cancelled() {
        let cancel = CancelToken::new();
        cancel.cancel();
        let signal = noise(4 * WORTH_A_THREAD);
        let mut left = signal.clone();
        Halves::new(Padding::Zeros, false).percussive(&mut left, &cancel);
        assert_eq!(left, signal);
    }
}
