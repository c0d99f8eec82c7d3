//! Fixtures, writers and comparisons that the tests of several crates share: a development
//! dependency of all others.
//!
//! ```
//! use bailando_testkit::{arrays, fixture, sound, wav};
//!
//! // Half a second of clicks as an audio file.
//! let song = wav::wav16(1, 8_000, &sound::clicks(0.5, 8_000, 0.1, Some(0.25)));
//! assert_eq!(song.len(), 44 + 2 * 4_000);
//!
//! // Golden values of a small model.
//! assert_eq!(arrays::floats(&fixture("model/music.npy")).ncols(), 438);
//! ```

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a fixture that is missing is a failed test"
)]

pub mod arrays;
pub mod corpus;
pub mod model;
pub mod motion;
pub mod ogg;
pub mod postgres;
pub mod rigs;
pub mod sound;
pub mod wav;

use std::path::{Path, PathBuf};

use serde_json::Value;

/// Returns the path of a file of the repository, from its root.
#[must_use]
pub fn project(relative: impl AsRef<Path>) -> PathBuf {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    Path::new(root).join(relative)
}

/// Returns the path of a file under `tests/fixtures`.
#[must_use]
pub fn fixture(relative: impl AsRef<Path>) -> PathBuf {
    project("tests/fixtures").join(relative)
}

/// Returns the bytes of an audio fixture, such as `demo.ogg`.
#[must_use]
pub fn song(name: &str) -> Vec<u8> {
    read(&fixture("audio").join(name))
}

/// Returns the path of shared test material: below `BAILANDO_SHARED`, by default `../shared` beside
/// the repository.
///
/// `None`, with one line on standard output, when neither is there; a missing file inside it is the
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

/// Returns the value in a JSON file.
#[must_use]
pub fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&read(path))
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
