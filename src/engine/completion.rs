//! The two ends of a request: the future that its caller waits on, and the engine's side of it.

use std::{
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, Wake, ready},
    thread::{self, Thread},
};

use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::{EngineError, GenerationOutput};
use crate::CancelToken;

/// A result that the engine works on. Dropping it cancels the work.
#[derive(Debug)]
#[must_use = "dropping it cancels the work"]
pub struct Pending<T>(oneshot::Receiver<Result<T, EngineError>>);

/// A generation under way.
pub type Generation = Pending<GenerationOutput>;

impl<T> Pending<T> {
    /// Blocks the calling thread until there is a result.
    ///
    /// # Errors
    /// Any [`EngineError`].
    pub fn wait(mut self) -> Result<T, EngineError> {
        let waker = Arc::new(Unpark(thread::current())).into();
        let mut context = Context::from_waker(&waker);
        loop {
            match Pin::new(&mut self).poll(&mut context) {
                Poll::Ready(result) => return result,
                Poll::Pending => thread::park(),
            }
        }
    }

    /// A result that is there already.
    pub fn ready(result: Result<T, EngineError>) -> Self {
        let (sender, receiver) = oneshot::channel();
        // The receiver is right here.
        let _ = sender.send(result);
        Self(receiver)
    }
}

/// Wakes a thread that waits.
struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

/// A sender that is dropped without a result means that the engine has stopped.
impl<T> From<oneshot::Receiver<Result<T, EngineError>>> for Pending<T> {
    fn from(receiver: oneshot::Receiver<Result<T, EngineError>>) -> Self {
        Self(receiver)
    }
}

impl<T> Future for Pending<T> {
    type Output = Result<T, EngineError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        let received = ready!(Pin::new(&mut self.0).poll(context));
        Poll::Ready(received.unwrap_or(Err(EngineError::Stopped)))
    }
}

/// The engine's side of a request.
pub(crate) struct Completion(Mutex<Option<oneshot::Sender<Result<GenerationOutput, EngineError>>>>);

impl Completion {
    pub(crate) fn new() -> (Arc<Self>, Generation) {
        let (sender, receiver) = oneshot::channel();
        (Arc::new(Self(Mutex::new(Some(sender)))), Pending(receiver))
    }

    /// Whether the caller still waits for a result.
    pub(crate) fn is_wanted(&self) -> bool {
        let sender = self.0.lock();
        sender.as_ref().is_some_and(|sender| !sender.is_closed())
    }

    /// A token that is cancelled once nobody waits.
    pub(crate) fn token(self: &Arc<Self>) -> CancelToken {
        let completion = Arc::clone(self);
        CancelToken::when(move || !completion.is_wanted())
    }

    /// Gives the caller the result; later ones are ignored.
    pub(crate) fn complete(&self, result: Result<GenerationOutput, EngineError>) {
        if let Some(sender) = self.0.lock().take() {
            // The caller may have gone meanwhile.
            let _ = sender.send(result);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_result_counts_and_a_lost_request_means_that_the_engine_stopped() {
        let (completion, pending) = Completion::new();
        assert!(completion.is_wanted());
        completion.complete(Err(EngineError::Cancelled));
        assert!(!completion.is_wanted());
        completion.complete(Err(EngineError::Stopped));
        assert!(matches!(pending.wait(), Err(EngineError::Cancelled)));

        let (completion, pending) = Completion::new();
        drop(completion);
        assert!(matches!(pending.wait(), Err(EngineError::Stopped)));
    }

    #[test]
    fn dropping_the_future_cancels() {
        let (completion, pending) = Completion::new();
        let token = completion.token();
        assert!(!token.is_cancelled());
        drop(pending);
        assert!(token.is_cancelled() && !completion.is_wanted());
    }
}
