//! An upload, and what its reader gets to see of it.

use bytes::Bytes;

use crate::container::Container;

/// An upload whose container is known.
#[derive(Clone, Debug)]
pub(crate) struct Upload {
    pub(crate) container: Container,
    /// The container's own bytes, without ID3 tags in front and after the audio.
    pub(crate) bytes: Bytes,
    /// The same as symphonia's reader shall see them, in slices.
    pub(crate) view: Vec<Bytes>,
    /// What was assumed about the file, in words.
    pub(crate) assumed: Vec<String>,
}

impl Upload {
    /// An upload without repairs.
    pub(crate) fn new(container: Container, bytes: Bytes) -> Self {
        Self { container, view: vec![bytes.clone()], bytes, assumed: Vec::new() }
    }
}
