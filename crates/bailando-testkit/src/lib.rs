//! Fixtures and writers that the tests of several crates share. A development dependency of all others.
//!
//! ```
//! let song = bailando_testkit::wav::wav16(1, 8_000, &[0; 800]);
//! assert_eq!(song.len(), 44 + 1_600);
//! ```

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a fixture that is missing is a failed test"
)]

pub mod corpus;
pub mod motion;
pub mod wav;

use std::path::{Path, PathBuf};

/// Path of a file of the repository, from its root.
#[must_use]
pub fn project(relative: impl AsRef<Path>) -> PathBuf {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    Path::new(root).join(relative)
}

/// Path of a file under `tests/fixtures`.
#[must_use]
pub fn fixture(relative: impl AsRef<Path>) -> PathBuf {
    project("tests/fixtures").join(relative)
}

/// Bytes of an audio fixture, such as `demo.ogg`.
#[must_use]
pub fn song(name: &str) -> Vec<u8> {
    let path = fixture("audio").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Path of shared test material: `BAILANDO_SHARED`, default `../shared` beside the repository.
/// `None` (with one line on standard output) when neither is there; a missing file inside it is the
/// caller's failure.
#[must_use]
pub fn shared(relative: &str) -> Option<PathBuf> {
    let root = match std::env::var_os("BAILANDO_SHARED") {
        Some(root) => PathBuf::from(root),
        None => {
            let default = project("../shared");
            if !default.is_dir() {
                println!("skipped: needs {relative} of BAILANDO_SHARED");
                return None;
            }
            default
        }
    };
    Some(root.join(relative))
}
