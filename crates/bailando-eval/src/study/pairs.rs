//! Pairs of dances to one song.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use crate::{
    error::EvaluationError,
    files::{entries, stem},
    load::motion_files,
    music::is_song,
};

/// Two dances to a song, which have its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Pair {
    pub(super) name: String,
    pub(super) a: PathBuf,
    pub(super) b: PathBuf,
    pub(super) song: PathBuf,
}

/// Lists the pairs by name, and the names that are not in all three folders.
///
/// # Errors
/// [`EvaluationError`] if a folder cannot be read, or there is no pair.
pub(super) fn pairs(
    a: &Path,
    b: &Path,
    songs: &Path,
) -> Result<(Vec<Pair>, Vec<String>), EvaluationError> {
    let named = |files: Vec<PathBuf>| -> BTreeMap<String, PathBuf> {
        files.into_iter().map(|path| (stem(&path), path)).collect()
    };
    let mut second = named(motion_files(b)?);
    let mut music = entries(songs)?;
    music.retain(|path| path.is_file() && is_song(path));
    let mut music = named(music);
    let (mut pairs, mut left) = (Vec::new(), Vec::new());
    for (name, a) in named(motion_files(a)?) {
        match (second.remove(&name), music.remove(&name)) {
            (Some(b), Some(song)) => pairs.push(Pair { name, a, b, song }),
            _ => left.push(name),
        }
    }
    left.extend(second.into_keys());
    if pairs.is_empty() {
        let problem = format!(
            "no dance has the name of one in {} and of a song in {}",
            b.display(),
            songs.display()
        );
        return Err(EvaluationError::file(a, problem));
    }
    Ok((pairs, left))
}
