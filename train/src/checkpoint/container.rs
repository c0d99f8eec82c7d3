//! The two containers behind one face.

use std::borrow::Cow;

use super::{
    error::Problem,
    legacy::{self, LegacyFile},
    pickle::{Pickled, Storage},
    zipped::ZipFile,
};

/// An opened checkpoint file.
#[derive(Debug)]
pub(super) enum Container {
    Zip(ZipFile),
    Legacy(LegacyFile),
}

impl Container {
    /// Tells the container from its first bytes and interprets the pickle inside.
    pub(super) fn open(bytes: Vec<u8>) -> Result<(Self, Pickled), Problem> {
        if bytes.starts_with(b"PK") {
            let (file, pickled) = ZipFile::open(bytes)?;
            Ok((Self::Zip(file), pickled))
        } else if bytes.starts_with(legacy::MAGIC) {
            let (file, pickled) = LegacyFile::open(bytes)?;
            Ok((Self::Legacy(file), pickled))
        } else {
            Err(Problem::UnknownContainer)
        }
    }

    /// The little-endian bytes of a storage: exactly as many as it declares.
    pub(super) fn storage(&mut self, storage: &Storage) -> Result<Cow<'_, [u8]>, Problem> {
        let bytes = match self {
            Self::Zip(file) => Cow::Owned(file.storage(&storage.key)?),
            Self::Legacy(file) => Cow::Borrowed(file.storage(&storage.key)?),
        };
        let expected = storage.values.checked_mul(storage.element.bytes());
        if expected == Some(bytes.len()) {
            return Ok(bytes);
        }
        Err(Problem::StorageSize {
            key: storage.key.to_string(),
            expected: expected.unwrap_or(usize::MAX) as u64,
            found: bytes.len() as u64,
        })
    }
}
