//! The body of a request while it is read: bounded in bytes and in time, and read to its end even
//! after a refusal.

use std::{
    error::Error,
    future::Future,
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use futures_util::Stream;
use http_body_util::BodyExt;
use tokio::time::{Instant, Sleep, sleep_until};
use tokio_util::sync::WaitForCancellationFutureOwned;
use tower_http::timeout::{DeadlineBody, TimeoutBody, TimeoutError};

use crate::server::{
    config::{Limits, Seconds},
    resources::{HeldBytes, UploadReservation},
};

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
    #[error("the body made room for another")]
    Displaced,
    #[error("uploads take all of the memory for them")]
    NoRoom { retry_after: Seconds },
    #[error("the form holds too much beside its parts")]
    FormOverhead,
    #[error("the lines of the form end with LF")]
    FormLines,
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
    pace: Option<Pace>,
    transfer: Option<Transfer>,
}

/// How much must arrive in every period.
#[derive(Debug)]
struct Pace {
    least: u64,
    arrived: u64,
    period: Duration,
    ends: Pin<Box<Sleep>>,
}

impl Pace {
    fn new(limits: &Limits) -> Self {
        let period = limits.body_idle_timeout.0;
        Self {
            least: (limits.body_least_rate.0 as f64 * period.as_secs_f64()) as u64,
            arrived: 0,
            period,
            ends: Box::pin(sleep_until(Instant::now() + period)),
        }
    }

    /// Whether a period has ended with too little.
    fn is_too_slow(&mut self, context: &mut Context<'_>) -> bool {
        while self.ends.as_mut().poll(context).is_ready() {
            if self.arrived < self.least {
                return true;
            }
            self.arrived = 0;
            self.ends.as_mut().reset(Instant::now() + self.period);
        }
        false
    }
}

/// The place of a body on its way, which it may have to give up.
struct Transfer {
    displaced: Pin<Box<WaitForCancellationFutureOwned>>,
    arrived: Box<dyn Fn(usize) + Send>,
}

impl std::fmt::Debug for Transfer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Transfer").finish_non_exhaustive()
    }
}

impl IncomingBody {
    pub(crate) fn new(body: Body) -> Self {
        let ended = body.is_end_stream();
        Self {
            declared: body.size_hint().exact(),
            body,
            left: u64::MAX,
            ended,
            held: None,
            pace: None,
            transfer: None,
        }
    }

    /// The length that the sender declared.
    pub(crate) fn declared(&self) -> Option<u64> {
        self.declared
    }

    /// Starts all deadlines: time without data, time for so much of it, and time in all.
    pub(crate) fn timed(mut self, limits: &Limits) -> Self {
        let (idle, total) = (limits.body_idle_timeout.0, limits.body_timeout.0);
        let body = std::mem::take(&mut self.body);
        self.body = Body::new(TimeoutBody::new(idle, DeadlineBody::new(total, body)));
        self.pace = Some(Pace::new(limits));
        self
    }

    /// Ends with [`BodyError::TooLarge`] after `most` bytes.
    pub(crate) fn limited(mut self, most: u64) -> Self {
        self.left = most;
        self
    }

    /// Adds what arrives to what `place` holds, and ends with [`BodyError::NoRoom`] where there is
    /// no room, or with [`BodyError::Displaced`] where it must give way.
    pub(crate) fn counted(mut self, place: &UploadReservation) -> Self {
        self.held = Some(place.bytes());
        self.transfer = place.transfer().map(|(displaced, arrived)| Transfer {
            displaced: Box::pin(displaced.cancelled_owned()),
            arrived: Box::new(arrived),
        });
        self
    }

    /// Why the body must end now, if it must.
    fn must_end(&mut self, context: &mut Context<'_>) -> Option<BodyError> {
        let displaced = self.transfer.as_mut().map(|transfer| transfer.displaced.as_mut());
        if displaced.is_some_and(|displaced| displaced.poll(context).is_ready()) {
            return Some(BodyError::Displaced);
        }
        let slow = self.pace.as_mut().is_some_and(|pace| pace.is_too_slow(context));
        slow.then_some(BodyError::TooSlow)
    }

    fn take_in(&mut self, bytes: usize) -> Result<(), BodyError> {
        let left = self.left.checked_sub(bytes as u64);
        self.left = left.ok_or(BodyError::TooLarge)?;
        if let Some(pace) = &mut self.pace {
            pace.arrived += bytes as u64;
        }
        if let Some(transfer) = &self.transfer {
            (transfer.arrived)(bytes);
        }
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
        if let Some(error) = self.must_end(context) {
            self.ended = true;
            return Poll::Ready(Some(Err(error)));
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
