//! The body of a response while it is sent. Its resources are given back when all of it was sent,
//! or when the client reads nothing for too long.

use std::{
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::body::Body;
use bytes::Bytes;
use futures_util::{Stream, StreamExt, stream};
use tokio::{
    task::JoinHandle,
    time::{Instant, sleep_until},
};

/// One piece of a response. With the idle timeout it sets the speed of the slowest client.
const PIECE: usize = 256 * 1024;

/// The client read nothing for too long.
#[derive(Debug, thiserror::Error)]
#[error("the client did not read the rest of the response")]
pub(crate) struct Abandoned;

/// Bytes with a guard that lives as long as any part of them.
struct Guarded<G> {
    bytes: Vec<u8>,
    _guard: G,
}

impl<G> AsRef<[u8]> for Guarded<G> {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Returns `bytes` as a body that ends when nothing of it is read for `idle_timeout`. `guard` lives
/// until all of it has been sent or dropped; `complete` is called when the last piece is read.
pub(crate) fn from_bytes<G: Send + Sync + 'static>(
    bytes: Vec<u8>,
    guard: G,
    idle_timeout: Duration,
    complete: impl FnOnce() + Send + 'static,
) -> Body {
    let held = Bytes::from_owner(Guarded { bytes, _guard: guard });
    let pieces = stream::unfold((held, Some(complete)), |(mut rest, mut complete)| async move {
        let piece = rest.split_to(PIECE.min(rest.len()));
        if rest.is_empty()
            && let Some(complete) = complete.take()
        {
            complete();
        }
        (!piece.is_empty()).then_some((piece, (rest, complete)))
    });
    from_stream(pieces, idle_timeout)
}

/// Returns a stream as a body that ends when its next part is not read within `idle_timeout`. Time
/// that the stream itself takes does not count.
pub(crate) fn from_stream(
    stream: impl Stream<Item = Bytes> + Send + 'static,
    idle_timeout: Duration,
) -> Body {
    let state = Arc::new(Mutex::new(State {
        stream: Some(Box::pin(stream)),
        idle_since: Some(Instant::now()),
    }));
    Body::from_stream(IdleTimeoutBody {
        watchdog: tokio::spawn(watch(Arc::clone(&state), idle_timeout)),
        state,
    })
}

type Parts = Pin<Box<dyn Stream<Item = Bytes> + Send>>;

/// The rest of a response.
struct State {
    stream: Option<Parts>,
    /// When the client last read; none while the stream itself is being waited for.
    idle_since: Option<Instant>,
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn watch(state: Arc<Mutex<State>>, idle_timeout: Duration) {
    loop {
        let since = lock(&state).idle_since.unwrap_or_else(Instant::now);
        sleep_until(since + idle_timeout).await;
        let mut state = lock(&state);
        let idle = state.idle_since.is_some_and(|since| since.elapsed() >= idle_timeout);
        if idle {
            let abandoned = state.stream.take();
            drop(state);
            drop(abandoned);
            return;
        }
    }
}

struct IdleTimeoutBody {
    state: Arc<Mutex<State>>,
    watchdog: JoinHandle<()>,
}

impl Stream for IdleTimeoutBody {
    type Item = Result<Bytes, Abandoned>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let mut state = lock(&self.state);
        let Some(stream) = &mut state.stream else {
            return Poll::Ready(Some(Err(Abandoned)));
        };
        let polled = stream.poll_next_unpin(context);
        state.idle_since = polled.is_ready().then(Instant::now);
        Poll::Ready(ready!(polled).map(Ok))
    }
}

impl Drop for IdleTimeoutBody {
    fn drop(&mut self) {
        self.watchdog.abort();
        let rest = lock(&self.state).stream.take();
        drop(rest);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use http_body_util::BodyExt;

    use super::*;

    const LONG: Duration = Duration::from_secs(60);
    const SHORT: Duration = Duration::from_millis(50);

    fn bytes() -> Vec<u8> {
        (0..2 * PIECE + 1).map(|i| (i % 251) as u8).collect()
    }

    async fn next(body: &mut Body) -> Bytes {
        body.frame().await.unwrap().unwrap().into_data().unwrap()
    }

    #[tokio::test]
    async fn the_guard_lives_as_long_as_any_byte() {
        let guard = Arc::new(());
        let complete = Arc::new(AtomicBool::new(false));
        let tell = Arc::clone(&complete);
        let mut body = from_bytes(bytes(), Arc::clone(&guard), LONG, move || {
            tell.store(true, Ordering::SeqCst);
        });
        let mut sent: Vec<u8> = Vec::new();
        while sent.len() < bytes().len() {
            assert!(!complete.load(Ordering::SeqCst));
            let piece = next(&mut body).await;
            sent.extend_from_slice(&piece);
            assert_eq!(Arc::strong_count(&guard), 2);
        }
        assert_eq!(sent, bytes());
        assert!(complete.load(Ordering::SeqCst));
        assert!(body.frame().await.is_none());
        drop(body);
        assert_eq!(Arc::strong_count(&guard), 1);
    }

    #[tokio::test]
    async fn a_dropped_body_is_not_complete() {
        let guard = Arc::new(());
        let mut body = from_bytes(bytes(), Arc::clone(&guard), LONG, || panic!("not complete"));
        next(&mut body).await;
        drop(body);
        assert_eq!(Arc::strong_count(&guard), 1);
    }

    #[tokio::test]
    async fn an_unread_body_is_dropped_after_the_idle_timeout() {
        let guard = Arc::new(());
        let mut body = from_bytes(bytes(), Arc::clone(&guard), SHORT, || panic!("not complete"));
        drop(next(&mut body).await);
        tokio::time::sleep(SHORT * 4).await;
        assert_eq!(Arc::strong_count(&guard), 1);
        assert!(body.frame().await.unwrap().is_err());
    }

    #[tokio::test]
    async fn time_of_the_stream_itself_does_not_count() {
        let slow = stream::once(async {
            tokio::time::sleep(SHORT * 5).await;
            Bytes::from_static(b"late")
        });
        let mut body = from_stream(slow, SHORT);
        assert_eq!(next(&mut body).await, "late");
    }
}
