//! Cancellation that reaches every phase: checked per audio packet and per generation step, and
//! able to interrupt a model run that is already under way.

use std::{
    fmt,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

type Hook = Box<dyn Fn() + Send + Sync>;

/// Cheap-clone handle that tells work to stop. All clones share one state.
#[derive(Clone, Default)]
pub struct CancelToken {
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    cancelled: AtomicBool,
    // The lock is held only to put, take or call the hook; a hook must not call back into the token.
    hook: Mutex<Option<Hook>>,
}

impl CancelToken {
    /// A token that has not been cancelled.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks all holders to stop, and interrupts the run registered by [`CancelToken::interruptible`].
    pub fn cancel(&self) {
        self.shared.cancelled.store(true, Ordering::SeqCst);
        let hook = self
            .shared
            .hook
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(interrupt) = hook.as_ref() {
            interrupt();
        }
    }

    /// Whether [`CancelToken::cancel`] has been called.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.shared.cancelled.load(Ordering::SeqCst)
    }

    /// Registers `interrupt` to be called on cancellation until the guard is dropped. If the token
    /// is cancelled already it is called at once. One registration at a time: a later one replaces
    /// an earlier one.
    pub fn interruptible(
        &self,
        interrupt: impl Fn() + Send + Sync + 'static,
    ) -> InterruptGuard<'_> {
        let mut hook = self
            .shared
            .hook
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if self.is_cancelled() {
            interrupt();
        }
        *hook = Some(Box::new(interrupt));
        InterruptGuard { token: self }
    }

    /// A guard that cancels when it is dropped, for callers whose future may be dropped midway.
    #[must_use]
    pub fn cancel_on_drop(&self) -> CancelOnDrop {
        CancelOnDrop {
            token: self.clone(),
        }
    }
}

impl fmt::Debug for CancelToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CancelToken")
            .field("cancelled", &self.is_cancelled())
            .finish()
    }
}

/// Removes the interrupt registered by [`CancelToken::interruptible`] when dropped.
#[derive(Debug)]
pub struct InterruptGuard<'token> {
    token: &'token CancelToken,
}

impl Drop for InterruptGuard<'_> {
    fn drop(&mut self) {
        *self
            .token
            .shared
            .hook
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// Cancels its token when dropped.
#[derive(Debug)]
pub struct CancelOnDrop {
    token: CancelToken,
}

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.token.cancel();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;

    #[test]
    fn hook_runs_on_cancel_and_not_after_its_guard_is_gone() {
        let calls = Arc::new(AtomicUsize::new(0));
        let token = CancelToken::new();
        let count = |calls: &Arc<AtomicUsize>| {
            let calls = Arc::clone(calls);
            move || {
                calls.fetch_add(1, Ordering::SeqCst);
            }
        };
        drop(token.interruptible(count(&calls)));
        token.cancel();
        assert_eq!(calls.load(Ordering::SeqCst), 0);
        assert!(token.is_cancelled());
        let _guard = token.interruptible(count(&calls));
        assert_eq!(
            calls.load(Ordering::SeqCst),
            1,
            "an already cancelled token interrupts at once"
        );
    }

    #[test]
    fn dropping_the_guard_cancels_every_clone() {
        let token = CancelToken::new();
        let other = token.clone();
        drop(token.cancel_on_drop());
        assert!(other.is_cancelled());
    }
}
