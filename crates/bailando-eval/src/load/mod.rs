//! Motions from files: NumPy arrays, our JSON and our BVH.

mod bvh;
mod json;
mod npy;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use super::{EvaluationError, Motion, body::FRAMES_PER_SECOND};

/// Frame rates this near to 60 are 60: BVH rounds its frame time.
const RATE_TOLERANCE: f64 = 0.01;

/// How a motion is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Npy,
    Json,
    Bvh,
}

impl Kind {
    fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "npy" => Some(Self::Npy),
            "json" => Some(Self::Json),
            "bvh" => Some(Self::Bvh),
            _ => None,
        }
    }
}

/// Reads a motion: `.npy` (`[frames, 24, 3]`, metres), `.json` or `.bvh` as this program writes
/// them. It is named after the file's stem.
///
/// # Errors
/// [`EvaluationError`] names the file and what is wrong with it.
pub fn load_motion(path: &Path) -> Result<Motion, EvaluationError> {
    let name = stem(path);
    let motion = match Kind::of(path) {
        Some(Kind::Npy) => npy::read(path).and_then(|positions| made(&name, &positions)),
        Some(Kind::Json) => text(path)?
            .parse::<json::JsonMotion>()
            .and_then(|read| Ok(made(&name, &read.positions)?.with_codes(read.codes))),
        Some(Kind::Bvh) => bvh::read(&text(path)?).and_then(|positions| made(&name, &positions)),
        None => Err("a motion is a .npy, .json or .bvh file".into()),
    };
    motion.map_err(|problem| EvaluationError::File {
        path: path.to_owned(),
        problem,
    })
}

/// The motion files directly inside a folder, by name; `index.json` is none.
///
/// # Errors
/// [`EvaluationError`] if the folder can't be read, or two files have one stem.
pub fn motion_files(folder: &Path) -> Result<Vec<PathBuf>, EvaluationError> {
    let mut files: BTreeMap<String, PathBuf> = BTreeMap::new();
    for path in entries(folder)? {
        let is_index = path.file_name().is_some_and(|name| name == "index.json");
        if is_index || Kind::of(&path).is_none() || !path.is_file() {
            continue;
        }
        if let Some(other) = files.insert(stem(&path), path.clone()) {
            return Err(EvaluationError::File {
                problem: format!("{} is a motion of the same piece", other.display()),
                path,
            });
        }
    }
    Ok(files.into_values().collect())
}

/// What lies directly inside a folder, by name.
pub(super) fn entries(folder: &Path) -> Result<Vec<PathBuf>, EvaluationError> {
    let io = |source| EvaluationError::Io {
        path: folder.to_owned(),
        source,
    };
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(io)? {
        paths.push(entry.map_err(io)?.path());
    }
    paths.sort();
    Ok(paths)
}

/// A text file.
pub(super) fn text(path: &Path) -> Result<String, EvaluationError> {
    fs::read_to_string(path).map_err(|source| EvaluationError::Io {
        path: path.to_owned(),
        source,
    })
}

pub(super) fn stem(path: &Path) -> String {
    path.file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

fn made(name: &str, positions: &ndarray::Array3<f32>) -> Result<Motion, String> {
    Motion::new(name, positions.view()).map_err(|error| match error {
        // The path says which one.
        EvaluationError::Motion { problem, .. } => problem,
        other => other.to_string(),
    })
}

fn check_rate(frames_per_second: f64) -> Result<(), String> {
    if (frames_per_second - FRAMES_PER_SECOND).abs() < RATE_TOLERANCE {
        Ok(())
    } else {
        Err(format!(
            "it has {frames_per_second} frames a second: the metrics are defined for 60"
        ))
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    #[test]
    fn a_folder_has_one_motion_per_stem() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        for name in ["b.npy", "a.bvh", "index.json", "song.ogg"] {
            fs::write(file(name), "").unwrap();
        }
        assert_eq!(
            motion_files(folder.path()).unwrap(),
            [file("a.bvh"), file("b.npy")]
        );
        fs::write(file("a.json"), "{}").unwrap();
        let message = motion_files(folder.path()).unwrap_err().to_string();
        assert!(message.contains("same piece"), "{message}");
    }

    #[test]
    fn errors_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wrong.npy");
        ndarray_npy::write_npy(&path, &Array3::<f32>::zeros((10, 22, 3))).unwrap();
        let message = load_motion(&path).unwrap_err().to_string();
        assert!(
            message.contains("wrong.npy") && message.contains("[10, 22, 3]"),
            "{message}"
        );
        let message = load_motion(&folder.path().join("none.bvh"))
            .unwrap_err()
            .to_string();
        assert!(message.contains("none.bvh"), "{message}");
    }
}
