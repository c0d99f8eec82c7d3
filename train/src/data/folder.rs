//! Our own layout: `index.json`, `.npy` motions and audio files (DESIGN, "Training data folder").
//! Files are shared between pieces: names come from the index, never from an id.

use std::path::Path;

use bailando::motion::Skeleton;
use serde::Deserialize;
use serde_json::Value;

use super::{
    DataError, Dataset, Defect, JOINTS, Layout, Marks, MotionSource, MusicSource, Phrase, Piece,
    Split, files,
};
use crate::export::skeleton;

pub(super) const INDEX: &str = "index.json";

/// Root heights are read from the motions; this only fills the skeleton's field.
pub(super) const ROOT_HEIGHT: f32 = 0.93;

#[derive(Debug, Deserialize)]
struct Index {
    joints: Option<Vec<String>>,
    parents: Option<Vec<i32>>,
    offsets: Option<Vec<[f32; 3]>>,
    fps: Option<f64>,
    pieces: Option<Vec<Value>>,
    /// Motion without music, all of it for training.
    recordings: Option<Vec<Value>>,
}

#[derive(Debug, Deserialize)]
struct Entry {
    id: String,
    split: Option<String>,
    motion: Option<String>,
    audio: Option<String>,
    frames: Option<usize>,
    seconds: Option<f64>,
    fps: Option<f64>,
    #[serde(default)]
    grid_beats_s: Vec<f64>,
    bpm: Option<f64>,
    source: Option<String>,
    style: Option<String>,
    first_count: Option<usize>,
    #[serde(default)]
    phrases: Vec<PhraseEntry>,
    /// First frame and the one after the last.
    #[serde(default)]
    damaged: Vec<[usize; 2]>,
}

/// A phrase of four bars or so: which bars of which clip.
#[derive(Debug, Deserialize)]
struct PhraseEntry {
    start_frame: usize,
    #[serde(default)]
    clip: String,
    #[serde(default)]
    start_bar: usize,
}

pub(super) fn read(root: &Path) -> Result<Dataset, DataError> {
    let path = root.join(INDEX);
    let index: Index = serde_json::from_slice(&files::read(&path)?)
        .map_err(|source| DataError::Json { path: path.clone(), source })?;
    let mut dataset = Dataset {
        root: root.to_owned(),
        layout: Layout::Folder,
        skeleton: skeleton(ROOT_HEIGHT),
        pieces: Vec::new(),
        defects: Vec::new(),
        absent: Vec::new(),
        notes: Vec::new(),
    };
    match index_skeleton(&index) {
        Ok(Some(skeleton)) => dataset.skeleton = skeleton,
        Ok(None) => dataset.notes.push(
            "index.json has no joints, parents and offsets: the SMPL skeleton is assumed".into(),
        ),
        Err(what) => dataset.defects.push(Defect { piece: INDEX.into(), what }),
    }
    if index.pieces.is_none() && index.recordings.is_none() {
        dataset
            .defects
            .push(Defect { piece: INDEX.into(), what: "there is no list `pieces` in it".into() });
    }
    for value in index.pieces.unwrap_or_default() {
        dataset.take(value, |entry| piece(root, entry, index.fps, None));
    }
    for value in index.recordings.unwrap_or_default() {
        dataset.take(value, |entry| piece(root, entry, index.fps, Some(Split::Train)));
    }
    Ok(dataset)
}

impl Dataset {
    fn take(&mut self, value: Value, build: impl FnOnce(Entry) -> Result<Piece, String>) {
        let name = value.get("id").and_then(Value::as_str).map(str::to_owned);
        let number = self.pieces.len() + self.defects.len() + 1;
        let name = name.unwrap_or_else(|| format!("entry {number}"));
        let entry = serde_json::from_value::<Entry>(value).map_err(|error| error.to_string());
        match entry.and_then(build) {
            Ok(piece) => self.pieces.push(piece),
            Err(what) => self.defects.push(Defect { piece: name, what }),
        }
    }
}

fn piece(
    root: &Path,
    mut entry: Entry,
    fps: Option<f64>,
    default: Option<Split>,
) -> Result<Piece, String> {
    let split = match (entry.split.as_deref(), default) {
        (Some("train"), _) => Split::Train,
        (Some("test"), _) => Split::Test,
        (None, Some(split)) => split,
        (Some(other), _) => return Err(format!("split is `{other}`, expected train or test")),
        (None, None) => return Err("it has no split: train or test".into()),
    };
    let motion = match (entry.motion.take(), default) {
        (Some(motion), _) => motion,
        // Lists of recordings name files by id.
        (None, Some(_)) => format!("{}.npy", entry.id),
        (None, None) => return Err("it names no motion file".into()),
    };
    let id = entry.id.clone();
    let marks = marks(&mut entry)?;
    Ok(Piece {
        id,
        split,
        marks,
        folder: 0,
        weight: 1.0,
        motion: MotionSource::Npy(root.join(motion)),
        music: entry.audio.map(|audio| MusicSource::Audio(root.join(audio))),
        frames: entry.frames,
        seconds: entry.seconds,
        fps: entry.fps.or(fps),
        grid_beats_s: entry.grid_beats_s,
        bpm: entry.bpm,
        source: entry.source,
    })
}

/// Reads phrases and damage, which must be in order.
fn marks(entry: &mut Entry) -> Result<Marks, String> {
    let phrases = entry.phrases.drain(..).map(|phrase| Phrase {
        start_frame: phrase.start_frame,
        name: format!("{}/{}", phrase.clip, phrase.start_bar),
    });
    let phrases: Vec<Phrase> = phrases.collect();
    if !phrases.is_sorted_by_key(|phrase| phrase.start_frame) {
        return Err("its phrases are not in the order of their first frames".into());
    }
    if let Some([from, to]) = entry.damaged.iter().find(|[from, to]| from > to) {
        return Err(format!("damaged frames {from} to {to}: the end comes first"));
    }
    Ok(Marks {
        style: entry.style.take(),
        phrases,
        damaged: entry.damaged.iter().map(|&[from, to]| from..to).collect(),
        first_count: entry.first_count.unwrap_or(1),
    })
}

/// The index's own skeleton. The networks' halves are lists of SMPL joints (ARCHITECTURE section
/// 1), so another order of joints would train nonsense without a word.
fn index_skeleton(index: &Index) -> Result<Option<Skeleton>, String> {
    let (Some(joints), Some(parents), Some(offsets)) =
        (&index.joints, &index.parents, &index.offsets)
    else {
        return Ok(None);
    };
    let expected = skeleton(ROOT_HEIGHT);
    let found = Skeleton {
        joints: joints.clone(),
        parents: parents.clone(),
        offsets: offsets.clone(),
        root_height: ROOT_HEIGHT,
    };
    found.validate().map_err(|error| error.to_string())?;
    if joints.len() != JOINTS || found.parents != expected.parents {
        return Err(format!(
            "joints and parents are not the {JOINTS} SMPL joints in SMPL order: {}",
            expected.joints.join(" ")
        ));
    }
    Ok(Some(found))
}
