//! The percussive part of a long signal, its halves side by side on two threads (FEATURES section 4).

use std::thread;

use super::{HOP, hpss::Separator, median::WINDOW, padding::Padding, stft::FRAME};

/// Frames beyond its border that a half needs: those under the median along time, those whose windows share samples with
/// theirs, and those that the padding at a signal's end reaches.
const MARGIN: usize = WINDOW / 2 + 2 * (FRAME / HOP);
/// Samples below which a second thread is not worth its start.
const WORTH_A_THREAD: usize = 256 * HOP;

/// Two separators; what they leave is what one alone would, bit for bit.
pub(super) struct Halves {
    separators: [Separator; 2],
}

impl Halves {
    pub(super) fn new(padding: Padding, silent_tail: bool) -> Self {
        Self {
            separators: [(); 2].map(|()| Separator::new(padding, silent_tail)),
        }
    }

    /// For a signal that shall have one thread.
    pub(super) fn alone(&mut self) -> &mut Separator {
        let [one, _] = &mut self.separators;
        one
    }

    /// Leaves the percussive part of `signal` in its place. Asks `goes_on` at every frame; once it says no, what is left is
    /// of no use.
    pub(super) fn percussive(&mut self, signal: &mut [f32], goes_on: impl Fn() -> bool + Sync) {
        let [one, other] = &mut self.separators;
        if signal.len() < WORTH_A_THREAD {
            one.split(signal, None, |_, _| goes_on());
            return;
        }
        // Frames lie where they lay in the whole: the border is between two hops.
        let border = signal.len() / 2 / HOP * HOP;
        let margin = MARGIN * HOP;
        let mut first = signal[..border + margin].to_vec();
        let second = &mut signal[border - margin..];
        let goes_on = &goes_on;
        thread::scope(|scope| {
            scope.spawn(|| one.split(&mut first, None, |_, _| goes_on()));
            other.split(second, None, |_, _| goes_on());
        });
        signal[..border].copy_from_slice(&first[..border]);
    }
}

#[cfg(test)]
mod tests {
    use super::{super::hpss::tests::noise, *};

    #[test]
    fn halves_are_those_of_the_whole() {
        for padding in [Padding::Zeros, Padding::Reflect] {
            for samples in [WORTH_A_THREAD - 1, WORTH_A_THREAD, WORTH_A_THREAD + 45_001] {
                let silent_tail = padding == Padding::Reflect;
                let mut whole = noise(samples);
                let mut halves = whole.clone();
                Separator::new(padding, silent_tail).split(&mut whole, None, |_, _| true);
                Halves::new(padding, silent_tail).percussive(&mut halves, || true);
                assert_eq!(whole, halves, "{samples} samples");
            }
        }
    }

    #[test]
    fn both_halves_leave_off_when_told_to() {
        let signal = noise(4 * WORTH_A_THREAD);
        let mut left = signal.clone();
        Halves::new(Padding::Zeros, false).percussive(&mut left, || false);
        assert_eq!(left, signal);
    }
}
