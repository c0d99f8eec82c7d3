//! The reference's layout: JSON files `{id, music_array [T][438], dance_array [T][72]}`, the dance
//! in world space at 60 frames a second. The music has as many rows (60 a second), an eighth of
//! them, or stands alone at 7.5 a second in a folder `music` under the song's name.

use std::path::{Path, PathBuf};

use bailando::{
    features::{COLUMNS, Rate},
    motion::Positions,
};
use ndarray::Array2;
use serde::{Deserialize, de::IgnoredAny};

use super::{
    DataError, Dataset, FRAMES_PER_CODE, JOINTS, Layout, Marks, MotionSource, MusicSource, Piece,
    Split, files, folder::ROOT_HEIGHT, songs::Songs,
};
use crate::export::skeleton;

/// Folder of feature files that hold music alone.
const MUSIC: &str = "music";
/// Bytes of a file that are read to find its kind.
const PEEK: usize = 1 << 16;

#[derive(Debug, Deserialize)]
struct DanceFile {
    dance_array: Vec<Vec<f32>>,
}

#[derive(Debug, Deserialize)]
struct MusicFile {
    music_array: Vec<Vec<f32>>,
    /// Only counted, to find the rate of the rows.
    dance_array: Option<Vec<IgnoredAny>>,
}

/// Lists the recordings in `root` and its folders; `None` where there is no JSON at all.
pub(super) fn recordings(root: &Path) -> Result<Option<Vec<PathBuf>>, DataError> {
    let mut dances = Vec::new();
    for path in files::list(root)? {
        if path.is_dir() && path.file_name().is_some_and(|name| name != MUSIC) {
            let inside = files::list(&path)?.into_iter();
            dances.extend(inside.filter(|path| is_dance(path)));
        } else if is_dance(&path) {
            dances.push(path);
        }
    }
    Ok(Some(dances).filter(|dances| !dances.is_empty()))
}

fn is_dance(path: &Path) -> bool {
    use std::io::Read;
    if !files::has_extension(path, &["json"]) {
        return false;
    }
    let mut start = Vec::new();
    let read =
        std::fs::File::open(path).and_then(|file| file.take(PEEK as u64).read_to_end(&mut start));
    // Music usually comes first and fills the look; what cannot be read is reported when it is.
    let keys: [&[u8]; 2] = [b"\"dance_array\"", b"\"music_array\""];
    read.is_err() || keys.iter().any(|key| start.windows(key.len()).any(|w| w == *key))
}

pub(super) fn read(
    root: &Path,
    dances: Vec<PathBuf>,
    audio: Option<&Path>,
) -> Result<Dataset, DataError> {
    let songs = Songs::audio(root, audio)?;
    let features = root.join(MUSIC);
    let mut rows = Songs::default();
    if features.is_dir() {
        rows.add(&features, &["json"])?;
    }
    let mut unsorted = 0;
    let pieces = dances.into_iter().map(|path| {
        let id = files::stem(&path);
        let split = split_of(root, &path).unwrap_or_else(|| {
            unsorted += 1;
            Split::Train
        });
        let music = match (songs.of(&id), rows.of(&id)) {
            (Some(song), _) => MusicSource::Audio(song.clone()),
            (None, Some(rows)) => MusicSource::Rows(rows.clone()),
            (None, None) => MusicSource::DanceRows(path.clone()),
        };
        bare_piece(id, split, MotionSource::Json(path), Some(music))
    });
    let pieces = pieces.collect();
    let notes = (unsorted > 0).then(|| {
        format!(
            "{unsorted} files lie in no folder with train or test in its name: taken for training"
        )
    });
    Ok(Dataset {
        root: root.to_owned(),
        layout: Layout::Reference,
        skeleton: skeleton(ROOT_HEIGHT),
        pieces,
        defects: Vec::new(),
        absent: Vec::new(),
        notes: notes.into_iter().collect(),
    })
}

/// A piece of a layout that declares nothing.
pub(super) fn bare_piece(
    id: String,
    split: Split,
    motion: MotionSource,
    music: Option<MusicSource>,
) -> Piece {
    Piece {
        id,
        split,
        motion,
        music,
        frames: None,
        seconds: None,
        fps: None,
        grid_beats_s: Vec::new(),
        bpm: None,
        source: None,
        marks: Marks::default(),
        folder: 0,
        weight: 1.0,
    }
}

/// Returns the split of a folder's name.
fn split_of(root: &Path, path: &Path) -> Option<Split> {
    let folder = path.parent()?.strip_prefix(root).ok()?;
    let folder = folder.to_string_lossy().to_lowercase();
    match (folder.contains("train"), folder.contains("test")) {
        (true, false) => Some(Split::Train),
        (false, true) => Some(Split::Test),
        _ => None,
    }
}

pub(super) fn positions(path: &Path) -> Result<Positions, DataError> {
    let file: DanceFile = parse(path)?;
    let flat = matrix(path, "dance_array", &file.dance_array, 3 * JOINTS)?;
    let frames = flat.nrows();
    let (values, _) = flat.into_raw_vec_and_offset();
    Positions::from_shape_vec((frames, JOINTS, 3), values)
        .map_err(|error| DataError::Shape { path: path.to_owned(), what: error.to_string() })
}

/// Rows of `music_array` and their rate. A file of music alone has 7.5 a second.
pub(super) fn rows(path: &Path) -> Result<(Array2<f32>, Rate), DataError> {
    let file: MusicFile = parse(path)?;
    let rows = matrix(path, "music_array", &file.music_array, COLUMNS)?;
    let frames = file.dance_array.map(|dance| dance.len());
    let rate = frames.map_or(Ok(Rate::Conditioning), |frames| {
        rate_of(rows.nrows(), frames).ok_or_else(|| DataError::Shape {
            path: path.to_owned(),
            what: format!(
                "{} rows of music beside {frames} frames: expected as many (60 a second) or an \
                 eighth (7.5 a second)",
                rows.nrows()
            ),
        })
    })?;
    Ok((rows, rate))
}

/// Returns the rate that fits the numbers of rows and frames, within half a second and 5 %.
fn rate_of(rows: usize, frames: usize) -> Option<Rate> {
    let near =
        |expected: usize, second: usize| rows.abs_diff(expected) <= (expected / 20).max(second / 2);
    if near(frames, 60) {
        Some(Rate::Beats)
    } else if near(frames / FRAMES_PER_CODE, 8) {
        Some(Rate::Conditioning)
    } else {
        None
    }
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, DataError> {
    serde_json::from_slice(&files::read(path)?)
        .map_err(|source| DataError::Json { path: path.to_owned(), source })
}

fn matrix(
    path: &Path,
    name: &str,
    rows: &[Vec<f32>],
    columns: usize,
) -> Result<Array2<f32>, DataError> {
    let odd = rows.iter().enumerate().find(|(_, row)| row.len() != columns);
    if let Some((row, values)) = odd {
        return Err(DataError::Shape {
            path: path.to_owned(),
            what: format!("row {row} of {name} has {} columns, expected {columns}", values.len()),
        });
    }
    let flat = rows.iter().flatten().copied().collect();
    Array2::from_shape_vec((rows.len(), columns), flat)
        .map_err(|error| DataError::Shape { path: path.to_owned(), what: error.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_told_by_the_numbers_of_rows() {
        assert_eq!(rate_of(600, 600), Some(Rate::Beats));
        assert_eq!(rate_of(585, 600), Some(Rate::Beats));
        assert_eq!(rate_of(76, 600), Some(Rate::Conditioning));
        assert_eq!(rate_of(300, 600), None);
        assert_eq!(rate_of(0, 600), None);
    }
}
