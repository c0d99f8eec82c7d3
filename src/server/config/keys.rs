//! API keys: read from settings or a file, never shown.

use std::{convert::Infallible, fmt, fs, io, path::Path, str::FromStr};

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// Longest key file that is read, in bytes.
const LONGEST_FILE: u64 = 64 * 1024;

/// A key that callers must send. Its text is never shown.
#[derive(Clone, PartialEq, Eq)]
pub struct ApiKey(String);

impl ApiKey {
    /// Compares in a time that depends on nothing but the lengths.
    #[must_use]
    pub fn is(&self, sent: &[u8]) -> bool {
        self.0.as_bytes().ct_eq(sent).into()
    }

    /// A part of the key's hash: says which key it is, and not what it is.
    pub(crate) fn fingerprint(&self) -> String {
        let hash = Sha256::digest(format!("bailando key {}", self.0));
        hash.iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl FromStr for ApiKey {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.trim().to_owned()))
    }
}

impl fmt::Debug for ApiKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ApiKey(..)")
    }
}

/// Why there are no keys to check.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeysError {
    /// The file cannot be read.
    #[error("the API keys in {path} cannot be read")]
    Read {
        /// The file.
        path: String,
        /// What the operating system says.
        source: io::Error,
    },
    /// A key was meant to be set, and is empty.
    #[error("--api-key (BAILANDO_API_KEY) is empty: give a key, or leave it out")]
    Empty,
    /// The file holds no key: a server that should require one must not start without.
    #[error("{path} holds no API key, or is larger than {LONGEST_FILE} bytes: write one a line")]
    None {
        /// The file.
        path: String,
    },
}

/// Reads the keys in a file, one a line.
pub(super) fn read(path: &Path) -> Result<Vec<ApiKey>, KeysError> {
    let named = || path.display().to_string();
    let failed = |source| KeysError::Read { path: named(), source };
    let length = fs::metadata(path).map_err(failed)?.len();
    if length > LONGEST_FILE {
        return Err(KeysError::None { path: named() });
    }
    let text = fs::read_to_string(path).map_err(failed)?;
    let keys: Vec<ApiKey> = text
        .lines()
        .map(|line| ApiKey(line.trim().to_owned()))
        .filter(|key| !key.is_empty())
        .collect();
    match keys.is_empty() {
        true => Err(KeysError::None { path: named() }),
        false => Ok(keys),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_compared_whole_and_never_shown() {
        let key: ApiKey = " secret ".parse().unwrap();
        assert!(key.is(b"secret"));
        for other in [&b"secre"[..], b"secrets", b"Secret", b""] {
            assert!(!key.is(other));
        }
        assert_eq!(format!("{key:?}"), "ApiKey(..)");
    }

    #[test]
    fn a_file_has_one_key_a_line_and_at_least_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keys");
        fs::write(&path, "one\n\n  two \r\n").unwrap();
        let keys = read(&path).unwrap();
        assert!(keys[0].is(b"one") && keys[1].is(b"two") && keys.len() == 2);
        fs::write(&path, " \n\n").unwrap();
        assert!(matches!(read(&path), Err(KeysError::None { .. })));
        let missing = folder.path().join("missing");
        assert!(matches!(read(&missing), Err(KeysError::Read { .. })));
    }
}
