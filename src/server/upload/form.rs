//! The body of a form on its way to the form's parser. The parser keeps its whole input until it
//! has found a boundary or the end of a part's head, and searches all of it again with every piece.

use std::{
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    task::{Context, Poll, ready},
};

use bytes::Bytes;
use futures_util::Stream;

use super::body::{BodyError, IncomingBody};
use crate::server::config::FORM_OVERHEAD;

/// Most bytes that the parser is given at once, well below [`FORM_OVERHEAD`].
const PIECE: usize = 16 * 1024;

/// A body in pieces, which ends with [`BodyError::FormOverhead`] where it holds too much beside its
/// parts.
pub(crate) struct FormBody {
    body: IncomingBody,
    /// Received, and not given to the parser yet.
    rest: Bytes,
    kept: Arc<Kept>,
}

impl FormBody {
    pub(crate) fn new(body: IncomingBody) -> Self {
        Self { body, rest: Bytes::new(), kept: Arc::default() }
    }

    /// The count of what the parser keeps, for the reader of the parts.
    pub(crate) fn kept(&self) -> Arc<Kept> {
        Arc::clone(&self.kept)
    }
}

/// Bytes that the parser was given and has not delivered.
#[derive(Debug, Default)]
pub(crate) struct Kept {
    bytes: AtomicU64,
    /// The parser must look at what it keeps before it is given more.
    look_first: AtomicBool,
}

impl Kept {
    fn give(&self, bytes: usize) -> Result<(), BodyError> {
        self.look_first.store(true, Ordering::Relaxed);
        let before = self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        match before.saturating_add(bytes as u64) > FORM_OVERHEAD {
            true => Err(BodyError::FormOverhead),
            false => Ok(()),
        }
    }

    /// Notes that the parser has delivered a part, or so many bytes of one; it may deliver more.
    pub(crate) fn delivered(&self, bytes: usize) {
        self.look_first.store(true, Ordering::Relaxed);
        self.bytes.fetch_sub(bytes as u64, Ordering::Relaxed);
    }
}

impl Stream for FormBody {
    type Item = Result<Bytes, BodyError>;

    /// Gives one piece at a time, and only when the parser can deliver nothing of the last one. The
    /// parser takes all that is ready before it looks at any of it: without this pause it would
    /// take in a whole body.
    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.kept.look_first.swap(false, Ordering::Relaxed) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        if self.rest.is_empty() {
            match ready!(Pin::new(&mut self.body).poll_next(context)) {
                Some(Ok(data)) => self.rest = data,
                ended => return Poll::Ready(ended),
            }
        }
        let length = PIECE.min(self.rest.len());
        let piece = self.rest.split_to(length);
        Poll::Ready(Some(self.kept.give(length).map(|()| piece)))
    }
}
