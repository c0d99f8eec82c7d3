//! Cancellation: a question that long work asks now and then, per packet, frame or step.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

/// Cheap-clone handle that tells work to stop. All clones share one state.
#[derive(Clone, Default)]
pub struct CancelToken {
    cancelled: Arc<AtomicBool>,
    gone: Option<Arc<dyn Fn() -> bool + Send + Sync>>,
}

impl CancelToken {
    /// A token that has not been cancelled.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A token that is cancelled as soon as `gone` is true, for example because the receiver of
    /// the result was dropped. `gone` is called often and must return at once.
    #[must_use]
    pub fn when(gone: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self { gone: Some(Arc::new(gone)), ..Self::default() }
    }

    /// Asks all holders to stop.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::SeqCst);
    }

    /// Whether the work shall stop.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::SeqCst) || self.gone.as_ref().is_some_and(|gone| gone())
    }
}

impl fmt::Debug for CancelToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CancelToken").field("cancelled", &self.is_cancelled()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clones_share_their_state_and_a_condition_cancels() {
        let token = CancelToken::new();
        assert!(!token.clone().is_cancelled());
        token.clone().cancel();
        assert!(token.is_cancelled());

        let gone = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&gone);
        let token = CancelToken::when(move || seen.load(Ordering::SeqCst));
        assert!(!token.is_cancelled());
        gone.store(true, Ordering::SeqCst);
        assert!(token.is_cancelled());
    }
}
