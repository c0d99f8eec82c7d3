//! The body of a response while it is sent, in small pieces. A client that takes too little of it
//! in its time is given up, and with it everything that is held for it.

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
use tokio_util::sync::CancellationToken;

use crate::server::{config::Limits, serving::cut::Cut};

/// One piece of a response, copied: a connection keeps up to two, and nothing else of it.
const PIECE: usize = 16 * 1024;

/// The client read too little for too long.
#[derive(Debug, thiserror::Error)]
#[error("the client did not read the rest of the response")]
pub(crate) struct Abandoned;

/// How fast a response must be taken.
#[derive(Clone, Debug)]
pub(crate) struct Pace {
    /// Bytes a second, over each whole period.
    rate: u64,
    period: Duration,
    /// The period while the server stops: readers that are given up must not hold it.
    last_period: Duration,
    stopping: CancellationToken,
}

impl Pace {
    pub(crate) fn new(limits: &Limits, stopping: CancellationToken) -> Self {
        let period = limits.answer_idle_timeout.0;
        Self {
            rate: limits.answer_least_rate.0,
            period,
            last_period: period.min(limits.shutdown_timeout.0 / 3),
            stopping,
        }
    }

    fn period(&self) -> Duration {
        match self.stopping.is_cancelled() {
            true => self.last_period,
            false => self.period,
        }
    }

    /// Bytes that must be taken in a period: one at least.
    fn least(&self) -> u64 {
        ((self.rate as f64 * self.period().as_secs_f64()) as u64).max(1)
    }
}

/// Returns `bytes` as a body that is held, with `guard`, until all of it is taken or its reader is
/// given up; `complete` is called when its last piece is taken.
pub(crate) fn from_bytes(
    bytes: Bytes,
    guard: impl Send + 'static,
    pace: Pace,
    complete: impl FnOnce() + Send + 'static,
) -> Body {
    let parts = Box::pin(stream::empty());
    let (complete, guard) = (Some(Box::new(complete) as _), Box::new(guard));
    body(Unsent { parts, rest: bytes, complete, _guard: guard }, pace)
}

/// Returns a stream as a body whose reader is given up if it takes too little of what is there.
/// Time that the stream itself takes does not count.
pub(crate) fn from_stream(parts: impl Stream<Item = Bytes> + Send + 'static, pace: Pace) -> Body {
    let parts = Box::pin(parts);
    body(Unsent { parts, rest: Bytes::new(), complete: None, _guard: Box::new(()) }, pace)
}

fn body(unsent: Unsent, pace: Pace) -> Body {
    let state = Arc::new(Mutex::new(State {
        unsent: Some(unsent),
        since: Some(Instant::now()),
        waited: Duration::ZERO,
        taken: 0,
        writer: None,
    }));
    let watchdog = tokio::spawn(watch(Arc::clone(&state), pace));
    Body::from_stream(PacedBody { state, watchdog })
}

/// What is still to be sent, and what is held for it.
struct Unsent {
    parts: Pin<Box<dyn Stream<Item = Bytes> + Send>>,
    /// Of the part that is being sent.
    rest: Bytes,
    complete: Option<Box<dyn FnOnce() + Send>>,
    _guard: Box<dyn Send>,
}

impl Unsent {
    /// The next piece of what is there. The last byte of a part is a piece of its own: a connection
    /// asks for it only once its reader has room for all before, so that the end of a response is
    /// watched as its middle is.
    fn piece(&mut self) -> Bytes {
        let length = match self.rest.len() {
            one @ 0..=1 => one,
            more => PIECE.min(more - 1),
        };
        let piece = Bytes::copy_from_slice(&self.rest.split_to(length));
        if self.rest.is_empty()
            && let Some(complete) = self.complete.take()
        {
            complete();
        }
        piece
    }
}

struct State {
    /// None once the reader was given up.
    unsent: Option<Unsent>,
    /// Since when the reader has had something to take; none while there is nothing.
    since: Option<Instant>,
    /// How long it has taken for what it took in this period, and how much that was.
    waited: Duration,
    taken: u64,
    writer: Option<Cut>,
}

impl State {
    /// Whether a period is over, and with too little taken. Begins a new one where there was
    /// enough.
    fn is_too_slow(&mut self, pace: &Pace, now: Instant) -> bool {
        let waited = self.waited + self.since.map_or(Duration::ZERO, |since| now - since);
        if waited < pace.period() {
            return false;
        }
        if self.taken < pace.least() {
            return true;
        }
        (self.waited, self.taken) = (Duration::ZERO, 0);
        self.since = self.since.map(|_| now);
        false
    }

    /// When the period is over, if its reader takes nothing more.
    fn ends(&self, pace: &Pace) -> Instant {
        let since = self.since.unwrap_or_else(Instant::now);
        since + pace.period().saturating_sub(self.waited)
    }
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Gives the reader up once it is too slow.
async fn watch(state: Arc<Mutex<State>>, pace: Pace) {
    loop {
        let ends = lock(&state).ends(&pace);
        tokio::select! {
            () = sleep_until(ends) => {}
            () = pace.stopping.cancelled(), if !pace.stopping.is_cancelled() => continue,
        }
        let mut state = lock(&state);
        if state.is_too_slow(&pace, Instant::now()) {
            let given_up = state.unsent.take();
            let writer = state.writer.take();
            drop(state);
            drop(given_up);
            writer.into_iter().for_each(|writer| writer.cut());
            return;
        }
    }
}

struct PacedBody {
    state: Arc<Mutex<State>>,
    watchdog: JoinHandle<()>,
}

impl Stream for PacedBody {
    type Item = Result<Bytes, Abandoned>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let mut state = lock(&self.state);
        let state = &mut *state;
        state.writer = Cut::of_this_task();
        let now = Instant::now();
        state.waited += state.since.take().map_or(Duration::ZERO, |since| now - since);
        let Some(unsent) = &mut state.unsent else {
            return Poll::Ready(Some(Err(Abandoned)));
        };
        while unsent.rest.is_empty() {
            match ready!(unsent.parts.poll_next_unpin(context)) {
                None => return Poll::Ready(None),
                Some(part) => unsent.rest = part,
            }
        }
        let piece = unsent.piece();
        state.taken += piece.len() as u64;
        state.since = Some(now);
        Poll::Ready(Some(Ok(piece)))
    }
}

impl Drop for PacedBody {
    fn drop(&mut self) {
        self.watchdog.abort();
        let rest = lock(&self.state).unsent.take();
        drop(rest);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use http_body_util::BodyExt;

    use super::*;
    use crate::server::config::{ByteSize, Seconds};

    const SHORT: Duration = Duration::from_millis(60);

    fn pace(period: Duration, rate: u64) -> Pace {
        let limits = Limits {
            answer_idle_timeout: Seconds(period),
            answer_least_rate: ByteSize(rate),
            shutdown_timeout: Seconds(3 * SHORT),
            ..Limits::default()
        };
        Pace::new(&limits, CancellationToken::new())
    }

    fn patient() -> Pace {
        pace(Duration::from_secs(60), 1)
    }

    fn bytes() -> Bytes {
        (0..2 * PIECE + 2).map(|i| (i % 251) as u8).collect()
    }

    async fn next(body: &mut Body) -> Bytes {
        body.frame().await.unwrap().unwrap().into_data().unwrap()
    }

    #[tokio::test]
    async fn all_is_sent_in_pieces_that_hold_nothing_and_the_last_byte_is_one() {
        let complete = Arc::new(AtomicBool::new(false));
        let (guard, tell) = (Arc::new(()), Arc::clone(&complete));
        let mut body = from_bytes(bytes(), Arc::clone(&guard), patient(), move || {
            tell.store(true, Ordering::SeqCst);
        });
        let mut sent = Vec::new();
        for length in [PIECE, PIECE, 1, 1] {
            assert!(!complete.load(Ordering::SeqCst));
            let piece = next(&mut body).await;
            assert_eq!(piece.len(), length);
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
        let held = Arc::clone(&guard);
        let mut body = from_bytes(bytes(), held, patient(), || panic!("not complete"));
        next(&mut body).await;
        drop(body);
        assert_eq!(Arc::strong_count(&guard), 1);
    }

    #[tokio::test]
    async fn who_takes_nothing_is_given_up() {
        let guard = Arc::new(());
        let held = Arc::clone(&guard);
        let mut body = from_bytes(bytes(), held, pace(SHORT, 1), || panic!("not complete"));
        let piece = next(&mut body).await;
        tokio::time::sleep(SHORT * 4).await;
        assert_eq!(Arc::strong_count(&guard), 1);
        assert!(body.frame().await.unwrap().is_err());
        drop(piece);
    }

    /// Less than the least in every period, though never nothing.
    #[tokio::test]
    async fn who_takes_a_little_now_and_then_is_given_up_too() {
        let held = Arc::new(());
        let endless = stream::repeat(Bytes::from_static(&[0; 100]));
        let guarded = {
            let held = Arc::clone(&held);
            endless.inspect(move |_| assert_eq!(Arc::strong_count(&held), 2))
        };
        let mut body = from_stream(guarded, pace(SHORT, 1_000_000));
        let started = Instant::now();
        while let Some(Ok(_)) = body.frame().await {
            tokio::time::sleep(SHORT / 10).await;
            assert!(started.elapsed() < SHORT * 100);
        }
        assert!(started.elapsed() >= SHORT);
        assert_eq!(Arc::strong_count(&held), 1);
    }

    #[tokio::test]
    async fn a_server_that_stops_waits_for_no_reader_for_long() {
        let guard = Arc::new(());
        let pace = patient();
        let stopping = pace.stopping.clone();
        let mut body = from_bytes(bytes(), Arc::clone(&guard), pace, || panic!("not complete"));
        next(&mut body).await;
        stopping.cancel();
        tokio::time::sleep(SHORT * 4).await;
        assert_eq!(Arc::strong_count(&guard), 1);
    }

    #[tokio::test]
    async fn time_of_the_stream_itself_does_not_count() {
        let slow = stream::once(async {
            tokio::time::sleep(SHORT * 5).await;
            Bytes::from_static(b"late")
        });
        let mut body = from_stream(slow, pace(SHORT, 1));
        assert_eq!(next(&mut body).await, "lat");
        assert_eq!(next(&mut body).await, "e");
    }
}
