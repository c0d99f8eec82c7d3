//! A connection that is dropped when its client sends or reads nothing.

use std::{
    future::Future,
    io,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, ready},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::TcpStream,
    time::{Instant, Sleep, sleep, sleep_until},
};

use super::{heads::Heads, places::Place};
use crate::server::config::Limits;

/// Bytes that tell HTTP/1 from HTTP/2: the preface of the latter.
const PREFACE: usize = 24;

/// A connection whose client must name its protocol in time, and must keep reading what it is sent.
pub(super) struct IdleTimeoutStream {
    stream: TcpStream,
    /// Bytes of the preface that are still to come.
    preface_left: usize,
    preface_deadline: Pin<Box<Sleep>>,
    heads: Heads,
    place: Arc<Place>,
    /// A head over HTTP/1 has begun, after so many requests.
    head_begun: Option<u64>,
    head_timeout: Duration,
    head_deadline: Option<Pin<Box<Sleep>>>,
    write_timeout: Duration,
    write_deadline: Option<Pin<Box<Sleep>>>,
}

impl IdleTimeoutStream {
    pub(super) fn new(stream: TcpStream, place: Arc<Place>, limits: &Limits) -> Self {
        let until = Instant::now() + limits.header_read_timeout.0;
        Self {
            stream,
            preface_left: PREFACE,
            preface_deadline: Box::pin(sleep_until(until)),
            heads: Heads::default(),
            place,
            head_begun: None,
            head_timeout: limits.header_read_timeout.0,
            head_deadline: None,
            write_timeout: limits.answer_idle_timeout.0,
            write_deadline: None,
        }
    }

    /// Whether the head of a request has begun and not ended, after `new` more bytes. Over HTTP/1
    /// bytes that come while no request is in progress are those of the next head.
    fn is_in_head(&mut self, new: &[u8]) -> bool {
        self.heads.read(new);
        let (requests, idle) = self.place.requests();
        self.head_begun = match self.head_begun {
            Some(before) if idle && before == requests => Some(before),
            _ if idle && !new.is_empty() && self.heads.is_http1() => Some(requests),
            _ => None,
        };
        self.heads.is_incomplete() || self.head_begun.is_some()
    }

    /// Fails a write that has been pending for too long.
    fn checked<T>(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.write_deadline = None;
            return written;
        }
        let timeout = self.write_timeout;
        let deadline = self.write_deadline.get_or_insert_with(|| Box::pin(sleep(timeout)));
        ready!(deadline.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for IdleTimeoutStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        let new = buffer.filled().get(before..).unwrap_or_default();
        self.preface_left = self.preface_left.saturating_sub(new.len());
        let in_head = self.is_in_head(new);
        if read.is_pending() && self.preface_left > 0 {
            ready!(self.preface_deadline.as_mut().poll(context));
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        if !in_head {
            self.head_deadline = None;
            return read;
        }
        // From its first byte on, however many more come.
        let timeout = self.head_timeout;
        let deadline = self.head_deadline.get_or_insert_with(|| Box::pin(sleep(timeout)));
        if deadline.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        read
    }
}

impl AsyncWrite for IdleTimeoutStream {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.checked(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.checked(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
