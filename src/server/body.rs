//! The body of a request while it is read: bounded in bytes and in time, and read to its end even
//! when nobody wants it any more.

use std::{
    error::Error,
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use futures_util::Stream;
use http_body_util::BodyExt;
use tower_http::timeout::{DeadlineBody, TimeoutBody, TimeoutError};

/// How much of an unwanted body is still read, and for how long, so that its sender gets to see the
/// answer: closing a connection with unread bytes resets it, and the answer is lost.
const DISCARD_AT_MOST: u64 = 200_000_000;
const DISCARD_FOR: Duration = Duration::from_secs(5);

/// Why a body ended early.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BodyError {
    #[error("the body is too large")]
    TooLarge,
    #[error("the body was not sent in time")]
    TooSlow,
    #[error("the body broke off: {0}")]
    Broken(axum::Error),
}

/// A request's body. Dropped before its end, it reads the rest in the background and throws it
/// away.
#[derive(Debug)]
pub(crate) struct IncomingBody {
    body: Body,
    declared: Option<u64>,
    left: u64,
    ended: bool,
    pause: bool,
}

impl IncomingBody {
    pub(crate) fn new(body: Body) -> Self {
        let ended = body.is_end_stream();
        Self {
            declared: body.size_hint().exact(),
            body,
            left: u64::MAX,
            ended,
            pause: false,
        }
    }

    /// The length that the sender declared.
    pub(crate) fn declared(&self) -> Option<u64> {
        self.declared
    }

    /// Starts both clocks: time without data, and time in all.
    pub(crate) fn timed(mut self, idle: Duration, total: Duration) -> Self {
        let body = std::mem::take(&mut self.body);
        self.body = Body::new(TimeoutBody::new(idle, DeadlineBody::new(total, body)));
        self
    }

    /// Ends with [`BodyError::TooLarge`] after `most` bytes.
    pub(crate) fn limited(mut self, most: u64) -> Self {
        self.left = most;
        self
    }
}

impl Stream for IncomingBody {
    type Item = Result<Bytes, BodyError>;

    /// One chunk at a time: the form's parser takes all that is ready before it looks at any of
    /// it, and would so take in a whole body that is refused at its first bytes.
    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.ended {
            return Poll::Ready(None);
        }
        if std::mem::take(&mut self.pause) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        loop {
            match ready!(Pin::new(&mut self.body).poll_frame(context)) {
                None => {
                    self.ended = true;
                    return Poll::Ready(None);
                }
                Some(Err(error)) => {
                    self.ended = true;
                    return Poll::Ready(Some(Err(explain(error))));
                }
                Some(Ok(frame)) => {
                    // Trailers say nothing about audio.
                    let Ok(data) = frame.into_data() else {
                        continue;
                    };
                    let Some(left) = self.left.checked_sub(data.len() as u64) else {
                        return Poll::Ready(Some(Err(BodyError::TooLarge)));
                    };
                    self.left = left;
                    self.pause = true;
                    return Poll::Ready(Some(Ok(data)));
                }
            }
        }
    }
}

fn explain(error: axum::Error) -> BodyError {
    let mut source: Option<&(dyn Error + 'static)> = Some(&error);
    while let Some(cause) = source {
        if cause.is::<TimeoutError>() {
            return BodyError::TooSlow;
        }
        source = cause.source();
    }
    BodyError::Broken(error)
}

impl Drop for IncomingBody {
    fn drop(&mut self) {
        if self.ended {
            return;
        }
        let mut body = std::mem::take(&mut self.body);
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            runtime.spawn(tokio::time::timeout(DISCARD_FOR, async move {
                let mut left = DISCARD_AT_MOST;
                while let Some(Ok(frame)) = body.frame().await {
                    let length = frame.data_ref().map_or(0, Bytes::len) as u64;
                    match left.checked_sub(length) {
                        Some(rest) => left = rest,
                        None => break,
                    }
                }
            }));
        }
    }
}
