//! What has become of each song.

use std::path::Path;

use serde::Serialize;

use crate::cli::console::write_file;

/// What has become of a song.
pub(super) enum Outcome {
    Made,
    /// By an earlier run.
    There,
    /// By an earlier run with other options.
    Otherwise,
    /// Why.
    Failed(String),
}

/// What has become of all songs.
#[derive(Debug, Default, Serialize)]
pub(super) struct Report {
    made: Vec<String>,
    there: Vec<String>,
    /// Those of `there` that were made with other options.
    made_otherwise: Vec<String>,
    failed: Vec<Failure>,
}

#[derive(Debug, Serialize)]
struct Failure {
    song: String,
    error: String,
}

impl Report {
    pub(super) fn add(&mut self, song: &Path, outcome: Outcome) {
        let song = song.display().to_string();
        match outcome {
            Outcome::Made => self.made.push(song),
            Outcome::There => self.there.push(song),
            Outcome::Otherwise => {
                self.there.push(song.clone());
                self.made_otherwise.push(song);
            }
            Outcome::Failed(error) => self.failed.push(Failure { song, error }),
        }
    }

    pub(super) fn failed(&self) -> usize {
        self.failed.len()
    }

    /// What the caller may not expect.
    pub(super) fn warning(&self) -> Option<String> {
        let count = self.made_otherwise.len();
        (count > 0).then(|| {
            format!(
                "dances kept that were made with other options: {count}; --again makes them again"
            )
        })
    }

    pub(super) fn summary(&self) -> String {
        let (made, there, failed) = (self.made.len(), self.there.len(), self.failed.len());
        format!("{made} dances made, {there} there already, {failed} failed")
    }

    pub(super) fn write(&self, file: &Path) -> anyhow::Result<()> {
        write_file(file, serde_json::to_vec_pretty(self)?)
    }
}
