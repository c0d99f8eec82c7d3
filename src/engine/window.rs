//! Which part of the history the GPT sees at each step (ARCHITECTURE section 3).

use crate::model::WindowKind;

/// What to do at a step so that the model sees the right window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WindowStep {
    /// Clear the cache and run the codes from this index to the newest, at positions 0...
    Prefill {
        /// Index of the window's first code.
        start: usize,
    },
    /// The window grows by the newest code: one step on top of the cache.
    Extend,
}

/// The moving window of past codes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    context: usize,
    shrink_to: usize,
}

impl Window {
    /// A window of at most `context` codes that shrinks to `hop` codes, or never shrinks.
    pub(crate) fn new(kind: WindowKind, hop: usize, context: usize) -> Self {
        let shrink_to = match kind {
            WindowKind::Sliding => context,
            WindowKind::Hop => hop.clamp(1, context.max(1)),
        };
        Self { context, shrink_to }
    }

    /// Codes in the window at `step`, when the history holds `step + 1` codes:
    /// `w = s + ((k - 28 - 1) mod (28 - s + 1))` beyond the context of 28.
    fn length(self, step: usize) -> usize {
        if step < self.context {
            return step + 1;
        }
        let period = self.context - self.shrink_to + 1;
        // (k - context - 1) may be -1: adding one period keeps it a natural number.
        self.shrink_to + (step - self.context + period - 1) % period
    }

    /// Index of the window's first code at `step`.
    pub(crate) fn start(self, step: usize) -> usize {
        step + 1 - self.length(step)
    }

    /// Whether the window's start moves at `step`.
    pub(crate) fn moves_at(self, step: usize) -> bool {
        matches!(self.at(step), WindowStep::Prefill { .. })
    }

    /// What to do at `step`: while the window's start stays, positions do not move and the cache
    /// of the step before is exact.
    pub(crate) fn at(self, step: usize) -> WindowStep {
        let start = self.start(step);
        match step.checked_sub(1) {
            Some(previous) if self.start(previous) == start => WindowStep::Extend,
            _ => WindowStep::Prefill { start },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sliding_always_holds_the_context_and_prefills_again() {
        let window = Window::new(WindowKind::Sliding, 15, 28);
        for step in 0..27 {
            assert_eq!(window.length(step), step + 1);
        }
        for step in 27..100 {
            assert_eq!(window.length(step), 28, "step {step}");
        }
        assert_eq!(window.at(28), WindowStep::Prefill { start: 1 });
        assert_eq!(window.at(60), WindowStep::Prefill { start: 33 });
    }

    #[test]
    fn hop_shrinks_at_the_steps_the_specification_lists() {
        let window = Window::new(WindowKind::Hop, 15, 28);
        let prefills: Vec<_> =
            (0..75).filter(|&step| matches!(window.at(step), WindowStep::Prefill { .. })).collect();
        assert_eq!(prefills, [0, 28, 29, 43, 57, 71]);
        assert_eq!(window.length(28), 28);
        assert_eq!((window.length(29), window.length(42), window.length(43)), (15, 28, 15));
        // Golden manifest: window_len_at of shift15.
        assert_eq!((window.length(10), window.length(40)), (11, 26));
    }

    #[test]
    fn a_window_of_one_code_and_a_hop_of_the_whole_context_work() {
        let narrow = Window::new(WindowKind::Hop, 1, 28);
        assert_eq!((narrow.length(29), narrow.length(56), narrow.length(57)), (1, 28, 1));
        let wide = Window::new(WindowKind::Hop, 28, 28);
        assert!((28..60).all(|step| wide.length(step) == 28));
    }
}
