//! The motions that everything is measured against: a training data folder (DESIGN.md), or any
//! folder of motions.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::{
    EvaluationError, Motion,
    load::{load_motion, motion_files, text},
};

/// The split whose recordings are the row beside the generated one.
pub const TEST_SPLIT: &str = "test";
/// The split that must not be recited.
const TRAIN_SPLIT: &str = "train";

/// A dance to a song. Several pieces can share a motion.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Its id.
    pub id: String,
    /// Which of the set's motions.
    pub motion: usize,
}

/// Motions, and the songs that they are danced to.
#[derive(Clone, Debug, Default)]
pub struct DanceSet {
    /// Each once.
    pub motions: Vec<Motion>,
    /// Which motion belongs to which song.
    pub pieces: Vec<Piece>,
}

impl DanceSet {
    /// Motions that are each danced to one song, named like the motion.
    #[must_use]
    pub fn from_motions(motions: Vec<Motion>) -> Self {
        let pieces = motions.iter().enumerate();
        let pieces = pieces
            .map(|(motion, named)| Piece {
                id: named.name().to_owned(),
                motion,
            })
            .collect();
        Self { motions, pieces }
    }

    /// The motions of a folder, or of one split of a data folder.
    ///
    /// # Errors
    /// [`EvaluationError`] if something can't be read, or there is nothing.
    pub fn load(folder: &Path, split: &str) -> Result<Self, EvaluationError> {
        if let Some(index) = Index::open(folder)? {
            return index.load(|piece| piece.split == split);
        }
        let motions: Result<Vec<Motion>, _> = motion_files(folder)?
            .iter()
            .map(|file| load_motion(file))
            .collect();
        let motions = motions?;
        if motions.is_empty() {
            return Err(EvaluationError::File {
                path: folder.to_owned(),
                problem: "there is no motion (.npy, .json or .bvh)".into(),
            });
        }
        Ok(Self::from_motions(motions))
    }
}

/// What a data folder says about one piece.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct PieceInfo {
    pub(super) id: String,
    #[serde(default)]
    pub(super) split: String,
    motion: PathBuf,
    #[serde(default)]
    pub(super) audio: Option<PathBuf>,
    #[serde(default)]
    pub(super) grid_beats_s: Vec<f64>,
    /// Other than 1: a recording played faster or slower, which is no recording.
    #[serde(default = "one")]
    tempo_factor: f64,
}

fn one() -> f64 {
    1.0
}

#[derive(Debug, Deserialize)]
struct IndexFile {
    pieces: Vec<PieceInfo>,
}

/// A data folder's table of contents.
#[derive(Debug)]
pub(super) struct Index {
    folder: PathBuf,
    pieces: Vec<PieceInfo>,
}

impl Index {
    /// None if the folder is no data folder.
    pub(super) fn open(folder: &Path) -> Result<Option<Self>, EvaluationError> {
        let path = folder.join("index.json");
        if !path.is_file() {
            return Ok(None);
        }
        let file: IndexFile =
            serde_json::from_str(&text(&path)?).map_err(|error| EvaluationError::File {
                path,
                problem: error.to_string(),
            })?;
        Ok(Some(Self {
            folder: folder.to_owned(),
            pieces: file.pieces,
        }))
    }

    /// The recordings among the pieces that `wanted` picks, each motion once.
    fn load(&self, wanted: impl Fn(&PieceInfo) -> bool) -> Result<DanceSet, EvaluationError> {
        let mut set = DanceSet::default();
        let mut known: HashMap<&Path, usize> = HashMap::new();
        let recorded = self.pieces.iter().filter(|piece| piece.tempo_factor == 1.0);
        for piece in recorded.filter(|piece| wanted(piece)) {
            let motion = match known.get(piece.motion.as_path()) {
                Some(&motion) => motion,
                None => {
                    set.motions
                        .push(load_motion(&self.folder.join(&piece.motion))?);
                    known.insert(&piece.motion, set.motions.len() - 1);
                    set.motions.len() - 1
                }
            };
            set.pieces.push(Piece {
                id: piece.id.clone(),
                motion,
            });
        }
        Ok(set)
    }
}

/// The reference: all recordings, and which of them are for testing and for training.
#[derive(Debug)]
pub struct Reference {
    folder: PathBuf,
    /// Every recording once.
    pub whole: DanceSet,
    /// The recordings beside which generated dances stand.
    pub test: DanceSet,
    /// The recordings that a model may recite.
    pub train: DanceSet,
    index: Option<BTreeMap<String, PieceInfo>>,
}

impl Reference {
    /// Reads a data folder, or a folder of motions, which then are their own test pieces.
    ///
    /// # Errors
    /// [`EvaluationError`] if something can't be read or the split has no recording.
    pub fn load(folder: &Path, split: &str) -> Result<Self, EvaluationError> {
        let Some(index) = Index::open(folder)? else {
            let whole = DanceSet::load(folder, split)?;
            return Ok(Self {
                folder: folder.to_owned(),
                test: whole.clone(),
                whole,
                train: DanceSet::default(),
                index: None,
            });
        };
        let whole = index.load(|_| true)?;
        let test = index.load(|piece| piece.split == split)?;
        if test.pieces.is_empty() {
            return Err(EvaluationError::File {
                path: folder.to_owned(),
                problem: format!("it has no recording of split {split}"),
            });
        }
        Ok(Self {
            folder: folder.to_owned(),
            whole,
            test,
            train: index.load(|piece| piece.split == TRAIN_SPLIT)?,
            index: Some(
                index
                    .pieces
                    .into_iter()
                    .map(|piece| (piece.id.clone(), piece))
                    .collect(),
            ),
        })
    }

    /// Where it was read from.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The split of a piece, "" where the reference tells none.
    ///
    /// # Errors
    /// [`EvaluationError::UnknownPiece`] if it is a data folder without this piece.
    pub fn split_of(&self, id: &str) -> Result<&str, EvaluationError> {
        match (&self.index, self.info(id)) {
            (_, Some(piece)) => Ok(&piece.split),
            (None, None) => Ok(""),
            (Some(_), None) => Err(EvaluationError::UnknownPiece {
                name: id.to_owned(),
                reference: self.folder.clone(),
            }),
        }
    }

    /// What the data folder says about a piece.
    pub(super) fn info(&self, id: &str) -> Option<&PieceInfo> {
        self.index.as_ref()?.get(id)
    }
}
