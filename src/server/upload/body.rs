//! The body of a request while it is read: bounded in bytes and in time, and read to its end even
//! after a refusal.

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

use crate::server::{config::Seconds, resources::HeldBytes};

/// How much of a refused body is still read, and for how long, so that its sender sees the answer:
/// closing a connection with unread bytes resets it, and the answer is lost.
const DISCARD_AT_MOST: u64 = 200_000_000;
const DISCARD_FOR: Duration = Duration::from_secs(5);

/// Why a body ended early.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BodyError {
    #[error("the body is too large")]
    TooLarge,
    #[error("the body was not sent in time")]
    TooSlow,
    #[error("uploads take all of the memory for them")]
    NoRoom { retry_after: Seconds },
    #[error("the form holds too much beside its parts")]
    FormOverhead,
    #[error("the body broke off: {0}")]
    Broken(axum::Error),
}

/// The body of a request. Dropped before its end, it reads the rest in the background and discards
/// it.
#[derive(Debug)]
pub(crate) struct IncomingBody {
    body: Body,
    declared: Option<u64>,
    left: u64,
    ended: bool,
    held: Option<HeldBytes>,
}

impl IncomingBody {
    pub(crate) fn new(body: Body) -> Self {
        let ended = body.is_end_stream();
        Self { declared: body.size_hint().exact(), body, left: u64::MAX, ended, held: None }
    }

    /// The length that the sender declared.
    pub(crate) fn declared(&self) -> Option<u64> {
        self.declared
    }

    /// Starts both deadlines: time without data, and time in all.
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

    /// Adds what arrives to `held`, and ends with [`BodyError::NoRoom`] where there is none.
    pub(crate) fn counted(mut self, held: HeldBytes) -> Self {
        self.held = Some(held);
        self
    }

    fn take_in(&mut self, bytes: usize) -> Result<(), BodyError> {
        let left = self.left.checked_sub(bytes as u64);
        self.left = left.ok_or(BodyError::TooLarge)?;
        let held = self.held.as_ref().map_or(Ok(()), |held| held.add(bytes));
        held.map_err(|retry_after| BodyError::NoRoom { retry_after })
    }
}

impl Stream for IncomingBody {
    type Item = Result<Bytes, BodyError>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.ended {
            return Poll::Ready(None);
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
                // Trailers say nothing about audio.
                Some(Ok(frame)) => {
                    if let Ok(data) = frame.into_data() {
                        return Poll::Ready(Some(self.take_in(data.len()).map(|()| data)));
                    }
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
