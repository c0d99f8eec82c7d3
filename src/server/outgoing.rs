//! The body of an answer while it is sent: what it holds is given back when it has been sent, or when
//! nobody takes it.

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

/// One piece of an answer: with the time that taking one may take, the slowest reader that is served.
const PIECE: usize = 256 * 1024;

/// The other end took nothing of its answer for too long.
#[derive(Debug, thiserror::Error)]
#[error("nobody took the rest of the answer")]
pub(crate) struct Abandoned;

/// Bytes that hold something for as long as any part of them is there.
struct Held<G> {
    bytes: Vec<u8>,
    _guard: G,
}

impl<G> AsRef<[u8]> for Held<G> {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// `bytes` as a body. `guard` is held until all of it has been taken and sent, or dropped; `taken` is called
/// when its last piece is asked for. Who asks for nothing for `patience` gets no more.
pub(crate) fn whole<G: Send + Sync + 'static>(
    bytes: Vec<u8>,
    guard: G,
    patience: Duration,
    taken: impl FnOnce() + Send + 'static,
) -> Body {
    let held = Bytes::from_owner(Held {
        bytes,
        _guard: guard,
    });
    let pieces = stream::unfold((held, Some(taken)), |(mut rest, mut taken)| async move {
        let piece = rest.split_to(PIECE.min(rest.len()));
        if rest.is_empty()
            && let Some(taken) = taken.take()
        {
            taken();
        }
        (!piece.is_empty()).then_some((piece, (rest, taken)))
    });
    attended(pieces, patience)
}

/// A stream as a body, which is given up when nobody asks for its next part within `patience`; time that the
/// stream itself takes does not count.
pub(crate) fn attended(
    stream: impl Stream<Item = Bytes> + Send + 'static,
    patience: Duration,
) -> Body {
    let seat = Arc::new(Mutex::new(Seat {
        stream: Some(Box::pin(stream)),
        asked: Some(Instant::now()),
    }));
    Body::from_stream(Attended {
        watchdog: tokio::spawn(watch(Arc::clone(&seat), patience)),
        seat,
    })
}

type Parts = Pin<Box<dyn Stream<Item = Bytes> + Send>>;

/// What is still to be sent.
struct Seat {
    stream: Option<Parts>,
    /// Since when nobody has asked for the next part, though there may be one.
    asked: Option<Instant>,
}

fn lock(seat: &Mutex<Seat>) -> MutexGuard<'_, Seat> {
    seat.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn watch(seat: Arc<Mutex<Seat>>, patience: Duration) {
    loop {
        let until = match lock(&seat).asked {
            Some(since) => since + patience,
            None => Instant::now() + patience,
        };
        sleep_until(until).await;
        let mut seat = lock(&seat);
        if seat.asked.is_some_and(|since| since.elapsed() >= patience) {
            let abandoned = seat.stream.take();
            drop(seat);
            drop(abandoned);
            return;
        }
    }
}

struct Attended {
    seat: Arc<Mutex<Seat>>,
    watchdog: JoinHandle<()>,
}

impl Stream for Attended {
    type Item = Result<Bytes, Abandoned>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let mut seat = lock(&self.seat);
        let Some(stream) = &mut seat.stream else {
            return Poll::Ready(Some(Err(Abandoned)));
        };
        let polled = stream.poll_next_unpin(context);
        seat.asked = polled.is_ready().then(Instant::now);
        Poll::Ready(ready!(polled).map(Ok))
    }
}

impl Drop for Attended {
    fn drop(&mut self) {
        self.watchdog.abort();
        let rest = lock(&self.seat).stream.take();
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
        let taken = Arc::new(AtomicBool::new(false));
        let tell = Arc::clone(&taken);
        let mut body = whole(bytes(), Arc::clone(&guard), LONG, move || {
            tell.store(true, Ordering::SeqCst);
        });
        let mut sent: Vec<u8> = Vec::new();
        while sent.len() < bytes().len() {
            assert!(!taken.load(Ordering::SeqCst));
            let piece = next(&mut body).await;
            sent.extend_from_slice(&piece);
            assert_eq!(Arc::strong_count(&guard), 2);
        }
        assert_eq!(sent, bytes());
        assert!(taken.load(Ordering::SeqCst));
        assert!(body.frame().await.is_none());
        drop(body);
        assert_eq!(Arc::strong_count(&guard), 1);
    }

    #[tokio::test]
    async fn a_body_that_is_dropped_was_not_taken() {
        let guard = Arc::new(());
        let mut body = whole(bytes(), Arc::clone(&guard), LONG, || panic!("not taken"));
        next(&mut body).await;
        drop(body);
        assert_eq!(Arc::strong_count(&guard), 1);
    }

    #[tokio::test]
    async fn what_nobody_takes_is_given_up() {
        let guard = Arc::new(());
        let mut body = whole(bytes(), Arc::clone(&guard), SHORT, || panic!("not taken"));
        drop(next(&mut body).await);
        tokio::time::sleep(SHORT * 4).await;
        assert_eq!(Arc::strong_count(&guard), 1);
        assert!(body.frame().await.unwrap().is_err());
    }

    #[tokio::test]
    async fn a_stream_may_take_its_time() {
        let slow = stream::once(async {
            tokio::time::sleep(SHORT * 5).await;
            Bytes::from_static(b"late")
        });
        let mut body = attended(slow, SHORT);
        assert_eq!(next(&mut body).await, "late");
    }
}
