//! The page of a study: one HTML file, a script of data for each pair, and the songs. It needs no
//! server and calls none.

use std::{
    fs,
    path::{Path, PathBuf},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use serde::Serialize;

use super::pairs::{Pair, pairs};
use crate::{
    body::{FRAMES_PER_SECOND, Motion},
    error::EvaluationError,
    load::load_motion,
};

const PAGE: &str = include_str!("page.html");
/// Frames a second that the page draws, and so many of ours between them.
const DRAWN_PER_SECOND: f64 = FRAMES_PER_SECOND / EVERY as f64;
const EVERY: usize = 2;
const MILLIMETRES: f64 = 1000.0;

/// What a study compares.
#[derive(Clone, Debug)]
pub struct StudyOptions {
    /// Dances of the first method: motions named after their songs.
    pub a: PathBuf,
    /// Dances of the second method.
    pub b: PathBuf,
    /// The songs.
    pub songs: PathBuf,
    /// The folder to write.
    pub output: PathBuf,
    /// Its name in the answers, so that those of two studies are not mixed.
    pub name: String,
}

/// A pair as the page has it. Which dance is of which method stays `a` and `b`; people see sides.
#[derive(Serialize)]
struct Entry<'a> {
    name: &'a str,
    song: String,
    /// Little-endian int16 millimetres, `[frames][24][3]`.
    a: String,
    b: String,
}

impl StudyOptions {
    /// Writes `index.html` and what it needs; returns the number of pairs and the names that are
    /// not in all three folders.
    ///
    /// # Errors
    /// [`EvaluationError`] names the file or folder.
    pub fn write(&self) -> Result<(usize, Vec<String>), EvaluationError> {
        let (pairs, left) = pairs(&self.a, &self.b, &self.songs)?;
        for folder in ["songs", "pairs"] {
            let folder = self.output.join(folder);
            fs::create_dir_all(&folder).map_err(EvaluationError::io(&folder))?;
        }
        let mut scripts = String::new();
        for (number, pair) in pairs.iter().enumerate() {
            scripts += &format!("<script src=\"pairs/{number}.js\"></script>\n");
            self.write_pair(number, pair)?;
        }
        let name = serde_json::to_string(&self.name).unwrap_or_default();
        let page = PAGE
            .replace("STUDY_NAME", &name.replace('<', "\\u003c"))
            .replace("DRAWN_PER_SECOND", &DRAWN_PER_SECOND.to_string())
            .replace("<!-- pairs -->", &scripts);
        write(&self.output.join("index.html"), &page)?;
        Ok((pairs.len(), left))
    }

    fn write_pair(&self, number: usize, pair: &Pair) -> Result<(), EvaluationError> {
        let extension = pair.song.extension().unwrap_or_default().to_string_lossy();
        // By number: names of songs may hold anything.
        let song = format!("songs/{number}.{extension}");
        let copy = self.output.join(&song);
        fs::copy(&pair.song, &copy).map_err(EvaluationError::io(&pair.song))?;
        let entry = Entry {
            name: &pair.name,
            song,
            a: packed(&load_motion(&pair.a)?),
            b: packed(&load_motion(&pair.b)?),
        };
        let json = serde_json::to_string(&entry)
            .map_err(|error| EvaluationError::file(&pair.song, error.to_string()))?;
        let json = json.replace('<', "\\u003c");
        write(&self.output.join(format!("pairs/{number}.js")), &format!("study.add({json});\n"))
    }
}

/// Positions at the drawn rate, with the first root at x = z = 0.
fn packed(motion: &Motion) -> String {
    let poses = motion.poses();
    let start = poses.first().map_or(glam::DVec3::ZERO, |pose| pose[0]);
    let bytes = poses.iter().step_by(EVERY).flatten().flat_map(|place| {
        let place = *place - glam::DVec3::new(start.x, 0.0, start.z);
        let millimetres = (place * MILLIMETRES).round();
        millimetres.to_array().map(|value| value as i16)
    });
    STANDARD.encode(bytes.flat_map(i16::to_le_bytes).collect::<Vec<u8>>())
}

fn write(path: &Path, text: &str) -> Result<(), EvaluationError> {
    fs::write(path, text).map_err(EvaluationError::io(path))
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    #[test]
    fn a_page_holds_the_pairs_and_nothing_of_other_hosts() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["a", "b", "songs"] {
            fs::create_dir(place(name)).unwrap();
        }
        let motion = |first: f32| {
            Array3::from_shape_fn((5, 24, 3), |(t, j, _)| {
                first + t as f32 * 0.001 + j as f32 * 0.01
            })
        };
        for (file, first) in [("a/one.npy", 2.0), ("b/one.npy", 1.0), ("b/two.npy", 1.0)] {
            ndarray_npy::write_npy(place(file), &motion(first)).unwrap();
        }
        fs::write(place("songs/one.mp3"), "song").unwrap();
        let options = StudyOptions {
            a: place("a"),
            b: place("b"),
            songs: place("songs"),
            output: place("study"),
            name: "</script>".to_owned(),
        };
        assert_eq!(options.write().unwrap(), (1, vec!["two".to_owned()]));
        let page = fs::read_to_string(place("study/index.html")).unwrap();
        assert!(page.contains("name: \"\\u003c/script>\"") && page.contains("rate: 30,"), "{page}");
        assert!(page.contains("<script src=\"pairs/0.js\"></script>") && !page.contains("://"));
        assert_eq!(fs::read(place("study/songs/0.mp3")).unwrap(), b"song");
        let script = fs::read_to_string(place("study/pairs/0.js")).unwrap();
        let json = script.strip_prefix("study.add(").and_then(|rest| rest.strip_suffix(");\n"));
        let entry: serde_json::Value = serde_json::from_str(json.unwrap()).unwrap();
        let bytes = STANDARD.decode(entry["a"].as_str().unwrap()).unwrap();
        // Three frames of five; the root begins at x = z = 0, and joint 1 is a centimetre away.
        assert_eq!(bytes.len(), 3 * 24 * 3 * 2);
        let values: Vec<i16> =
            bytes.chunks(2).map(|two| i16::from_le_bytes([two[0], two[1]])).collect();
        assert_eq!(values[..6], [0, 2000, 0, 10, 2010, 10]);
        let none = StudyOptions { songs: place("a"), ..options }.write().unwrap_err();
        assert!(none.to_string().contains("no dance has the name"), "{none}");
    }
}
