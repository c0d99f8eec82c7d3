//! Cancellation that reaches every phase: checked per audio packet and per generation step, and
//! able to interrupt a model run that is already under way.

use std::{
    fmt,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

/// What to call on cancellation, and the number that its guard knows it by.
type Hook = (u64, Box<dyn Fn() + Send + Sync>);

/// Cheap-clone handle that tells work to stop. All clones share one state.
#[derive(Clone, Default)]
pub struct CancelToken {
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    cancelled: AtomicBool,
    // The lock is held only to put, take or call hooks; a hook must not call back into the token.
    hooks: Mutex<Hooks>,
}

#[derive(Default)]
struct Hooks {
    next: u64,
    list: Vec<Hook>,
}

impl Shared {
    fn hooks(&self) -> MutexGuard<'_, Hooks> {
        self.hooks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CancelToken {
    /// A token that has not been cancelled.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks all holders to stop, and calls what [`CancelToken::interruptible`] registered.
    pub fn cancel(&self) {
        self.shared.cancelled.store(true, Ordering::SeqCst);
        for (_, interrupt) in &self.shared.hooks().list {
            interrupt();
        }
    }

    /// Whether [`CancelToken::cancel`] has been called.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.shared.cancelled.load(Ordering::SeqCst)
    }

    /// Registers `interrupt` to be called on cancellation until the guard is dropped. If the token
    /// is cancelled already it is called at once.
    pub fn interruptible(
        &self,
        interrupt: impl Fn() + Send + Sync + 'static,
    ) -> InterruptGuard<'_> {
        let mut hooks = self.shared.hooks();
        if self.is_cancelled() {
            interrupt();
        }
        let number = hooks.next;
        hooks.next += 1;
        hooks.list.push((number, Box::new(interrupt)));
        InterruptGuard {
            token: self,
            number,
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
    number: u64,
}

impl Drop for InterruptGuard<'_> {
    fn drop(&mut self) {
        let mut hooks = self.token.shared.hooks();
        hooks.list.retain(|(number, _)| *number != self.number);
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
}
