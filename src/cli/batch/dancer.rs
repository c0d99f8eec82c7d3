//! Whoever makes the dances of a batch.

use std::path::Path;

/// Makes one dance: writes the file of a song's result.
pub(super) trait Dancer: Sync {
    fn dance(&self, song: &Path, result: &Path) -> anyhow::Result<()>;
}
