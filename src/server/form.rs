//! The body of a form on its way to the form's parser, which keeps all that it is given until it has found
//! a boundary or the end of a part's head, and searches all of it again with every piece.

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

/// What a form may hold beside what its parts deliver: boundaries and part headers. The parser never has
/// more than that to keep.
pub(crate) const OVERHEAD: u64 = 64 * 1024;
/// Most bytes that the parser is given at once, well below [`OVERHEAD`].
const PIECE: usize = 16 * 1024;

/// A body in pieces, which ends with [`BodyError::FormOverhead`] where too much of it is no part's.
pub(crate) struct FormBody {
    body: IncomingBody,
    /// Has come, and was not given to the parser yet.
    rest: Bytes,
    kept: Arc<Kept>,
}

impl FormBody {
    pub(crate) fn new(body: IncomingBody) -> Self {
        Self {
            body,
            rest: Bytes::new(),
            kept: Arc::default(),
        }
    }

    /// What the parser keeps, for whoever takes the parts.
    pub(crate) fn kept(&self) -> Arc<Kept> {
        Arc::clone(&self.kept)
    }
}

/// What the parser was given and has not delivered.
#[derive(Debug, Default)]
pub(crate) struct Kept {
    bytes: AtomicU64,
    /// The parser is to look at what it keeps before it is given more.
    look_first: AtomicBool,
}

impl Kept {
    fn give(&self, bytes: usize) -> Result<(), BodyError> {
        self.look_first.store(true, Ordering::Relaxed);
        let before = self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        match before.saturating_add(bytes as u64) > OVERHEAD {
            true => Err(BodyError::FormOverhead),
            false => Ok(()),
        }
    }

    /// The parser has delivered a part, or so many bytes of one; it may be able to deliver more.
    pub(crate) fn delivered(&self, bytes: usize) {
        self.look_first.store(true, Ordering::Relaxed);
        self.bytes.fetch_sub(bytes as u64, Ordering::Relaxed);
    }
}

impl Stream for FormBody {
    type Item = Result<Bytes, BodyError>;

    /// One piece at a time, and only when the parser can deliver nothing of the last one: it takes all that
    /// is ready before it looks at any of it, and would so take in a whole body.
    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.kept.look_first.swap(false, Ordering::Relaxed) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        if self.rest.is_empty() {
            match ready!(Pin::new(&mut self.body).poll_next(context)) {
                Some(Ok(come)) => self.rest = come,
                ended => return Poll::Ready(ended),
            }
        }
        let length = PIECE.min(self.rest.len());
        let piece = self.rest.split_to(length);
        Poll::Ready(Some(self.kept.give(length).map(|()| piece)))
    }
}
