//! The three containers behind one face, and what is none of them by its name.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
};

use super::{
    error::Problem,
    legacy::{self, LegacyFile},
    names::{self, Views},
    pickle::Storage,
    safe::SafeFile,
    zipped::ZipFile,
};

/// First bytes of an entry of a zip archive, and of one without entries. A safetensors file may
/// begin with the first two of them.
const ZIP: [&[u8]; 2] = [b"PK\x03\x04", b"PK\x05\x06"];

/// An opened checkpoint file.
#[derive(Debug)]
pub(super) enum Container {
    Zip(ZipFile),
    Legacy(LegacyFile),
    Safetensors(SafeFile),
}

impl Container {
    /// Tells the container from its first bytes and finds the tensors inside.
    pub(super) fn open(bytes: Vec<u8>) -> Result<(Self, Views), Problem> {
        if ZIP.iter().any(|magic| bytes.starts_with(magic)) {
            let (file, pickled) = ZipFile::open(bytes)?;
            Ok((Self::Zip(file), names::of_pickle(&pickled)?))
        } else if bytes.starts_with(legacy::MAGIC) {
            let (file, pickled) = LegacyFile::open(bytes)?;
            Ok((Self::Legacy(file), names::of_pickle(&pickled)?))
        } else if SafeFile::is_this(&bytes) {
            let (file, views) = SafeFile::open(bytes)?;
            Ok((Self::Safetensors(file), views))
        } else {
            Err(unknown(&bytes))
        }
    }

    /// The little-endian bytes of a storage: exactly as many as it declares.
    pub(super) fn storage(&mut self, storage: &Storage) -> Result<Cow<'_, [u8]>, Problem> {
        let bytes = match self {
            Self::Zip(file) => Cow::Owned(file.storage(&storage.key)?),
            Self::Legacy(file) => Cow::Borrowed(file.storage(&storage.key)?),
            Self::Safetensors(file) => Cow::Borrowed(file.storage(&storage.key)?),
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

/// Names what is often taken for a checkpoint.
fn unknown(bytes: &[u8]) -> Problem {
    /// Where the index of a checkpoint in several files says which tensor is in which.
    #[derive(serde::Deserialize)]
    struct Index {
        weight_map: BTreeMap<String, String>,
    }
    match serde_json::from_slice::<Index>(bytes) {
        Ok(Index { weight_map }) => {
            let files: BTreeSet<String> = weight_map.into_values().collect();
            Problem::ShardIndex(files.into_iter().collect::<Vec<_>>().join(", "))
        }
        Err(_) => Problem::UnknownContainer,
    }
}
