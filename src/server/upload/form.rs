//! The body of a form on its way to the form's parser. The parser keeps its whole input until it
//! has found a boundary or the end of a part's head, and searches all of it again with every piece.
//! Small mistakes of clients that do not change what was meant are mended on the way.

use std::{
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    task::{Context, Poll, ready},
};

use axum::http::{HeaderMap, HeaderValue, header};
use bytes::Bytes;
use futures_util::Stream;

use super::body::{BodyError, IncomingBody};
use crate::server::config::FORM_OVERHEAD;

/// Most bytes that the parser is given at once, well below [`FORM_OVERHEAD`].
const PIECE: usize = 16 * 1024;

/// Returns the boundary that a `Content-Type` names, blanks and quotes around it or not.
pub(super) fn boundary(headers: &HeaderMap) -> Option<String> {
    let kind = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    let parameters = kind.split(';').skip(1).filter_map(|parameter| parameter.split_once('='));
    let named = |(name, _): &(&str, &str)| name.trim().eq_ignore_ascii_case("boundary");
    let (_, value) = parameters.into_iter().find(named)?;
    let value = value.trim().trim_matches('"');
    // RFC 2046, section 5.1.1; a quote would end the header's own quotes.
    let fits = !value.is_empty() && value.len() <= 70 && !value.contains(['"', '\\']);
    fits.then(|| value.to_owned())
}

/// The `Content-Type` of a form, as its parser wants it.
pub(super) fn content_type(boundary: &str) -> Option<HeaderValue> {
    HeaderValue::try_from(format!("multipart/form-data; boundary=\"{boundary}\"")).ok()
}

/// A body in pieces, which ends with [`BodyError::FormOverhead`] where it holds too much beside its
/// parts.
pub(crate) struct FormBody {
    body: IncomingBody,
    /// Received, and not given to the parser yet.
    rest: Bytes,
    kept: Arc<Kept>,
    /// The boundary, while nothing was received.
    boundary: Option<String>,
    /// What ends a form that began with a boundary: some clients leave the last one out. After it,
    /// nothing is read.
    closing: Bytes,
}

impl FormBody {
    pub(crate) fn new(body: IncomingBody, boundary: &str) -> Self {
        Self {
            body,
            rest: Bytes::new(),
            kept: Arc::default(),
            boundary: Some(boundary.to_owned()),
            closing: Bytes::new(),
        }
    }

    /// Looks at the first bytes of the form.
    fn begin(&mut self) -> Result<(), BodyError> {
        let Some(boundary) = self.boundary.take() else {
            return Ok(());
        };
        let line = format!("--{boundary}");
        if let Some(rest) = self.rest.strip_prefix(line.as_bytes()) {
            self.closing = format!("\r\n{line}--\r\n").into();
            return if rest.starts_with(b"\n") { Err(BodyError::FormLines) } else { Ok(()) };
        }
        Ok(())
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
                None if !self.closing.is_empty() => self.rest = std::mem::take(&mut self.closing),
                ended => return Poll::Ready(ended),
            }
        }
        if let Err(error) = self.begin() {
            return Poll::Ready(Some(Err(error)));
        }
        let length = PIECE.min(self.rest.len());
        let piece = self.rest.split_to(length);
        Poll::Ready(Some(self.kept.give(length).map(|()| piece)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_boundary_is_found_however_it_is_written() {
        for (kind, wanted) in [
            ("multipart/form-data; boundary=x", Some("x")),
            ("multipart/form-data ; charset=utf-8; Boundary = \"a b\" ", Some("a b")),
            ("multipart/form-data; boundary=x ; charset=utf-8", Some("x")),
            ("multipart/form-data; boundary=", None),
            ("multipart/form-data", None),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
            assert_eq!(boundary(&headers).as_deref(), wanted, "{kind}");
        }
    }
}
