//! Sets of motions, and the reference: a training data folder (DESIGN.md), or any folder of
//! motions.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
    rc::Rc,
};

use serde::Deserialize;

use crate::{
    body::Motion,
    error::EvaluationError,
    files::text,
    load::{load_motion, motion_files},
};

/// The split of the recordings in the reference's own row.
pub(crate) const TEST_SPLIT: &str = "test";
/// The split that must not be recited.
const TRAIN_SPLIT: &str = "train";

/// A motion to a song. Several pieces can share a motion.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    pub(crate) id: String,
    pub(crate) motion: Rc<Motion>,
    /// Of a recording, or asked for; none: not known.
    pub(crate) style: Option<String>,
}

/// Motions, and the songs that they belong to.
#[derive(Clone, Debug, Default)]
pub(crate) struct MotionSet {
    pub(crate) pieces: Vec<Piece>,
}

impl MotionSet {
    /// Takes motions of one song each, with the song's name.
    pub(crate) fn from_motions(motions: Vec<Motion>) -> Self {
        let pieces = motions.into_iter().map(|motion| Piece {
            id: motion.name().to_owned(),
            motion: Rc::new(motion),
            style: None,
        });
        Self { pieces: pieces.collect() }
    }

    /// Loads the motions of a folder, or of one split of a data folder.
    pub(crate) fn load(folder: &Path, split: &str) -> Result<Self, EvaluationError> {
        if let Some(index) = Index::open(folder)? {
            return index.load(|piece| piece.split == split);
        }
        let files = motion_files(folder)?;
        if files.is_empty() {
            let problem = "there is no motion (.npy, .json or .bvh)";
            return Err(EvaluationError::file(folder, problem));
        }
        let motions = files.iter().map(|file| load_motion(file));
        motions.collect::<Result<_, _>>().map(Self::from_motions)
    }

    /// The motions, each once, in the order of the pieces.
    pub(crate) fn motions(&self) -> Vec<&Motion> {
        let mut motions: Vec<&Rc<Motion>> = Vec::new();
        for piece in &self.pieces {
            if !motions.iter().any(|other| Rc::ptr_eq(other, &piece.motion)) {
                motions.push(&piece.motion);
            }
        }
        motions.into_iter().map(Rc::as_ref).collect()
    }

    /// The pieces of each style that is known.
    pub(crate) fn by_style(&self) -> BTreeMap<&str, Self> {
        let mut styles: BTreeMap<&str, Self> = BTreeMap::new();
        for piece in &self.pieces {
            if let Some(style) = &piece.style {
                styles.entry(style).or_default().pieces.push(piece.clone());
            }
        }
        styles
    }

    pub(crate) fn has(&self, id: &str) -> bool {
        self.pieces.iter().any(|piece| piece.id == id)
    }
}

/// An entry of a data folder's index.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct PieceInfo {
    id: String,
    #[serde(default)]
    split: String,
    motion: PathBuf,
    #[serde(default)]
    pub(crate) style: Option<String>,
    #[serde(default)]
    pub(crate) audio: Option<PathBuf>,
    #[serde(default)]
    pub(crate) grid_beats_s: Vec<f64>,
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
struct Index {
    folder: PathBuf,
    pieces: Vec<PieceInfo>,
}

impl Index {
    /// None if the folder is no data folder.
    fn open(folder: &Path) -> Result<Option<Self>, EvaluationError> {
        let path = folder.join("index.json");
        if !path.is_file() {
            return Ok(None);
        }
        let file: IndexFile = serde_json::from_str(&text(&path)?)
            .map_err(|error| EvaluationError::file(&path, error.to_string()))?;
        Ok(Some(Self { folder: folder.to_owned(), pieces: file.pieces }))
    }

    /// Loads the recordings among the pieces that `wanted` picks, each motion once.
    fn load(&self, wanted: impl Fn(&PieceInfo) -> bool) -> Result<MotionSet, EvaluationError> {
        let mut set = MotionSet::default();
        let mut known: HashMap<&Path, Rc<Motion>> = HashMap::new();
        let recorded = self.pieces.iter().filter(|piece| piece.tempo_factor == 1.0);
        for piece in recorded.filter(|piece| wanted(piece)) {
            let motion = match known.get(piece.motion.as_path()) {
                Some(motion) => Rc::clone(motion),
                None => Rc::new(load_motion(&self.folder.join(&piece.motion))?),
            };
            known.insert(&piece.motion, Rc::clone(&motion));
            let (id, style) = (piece.id.clone(), piece.style.clone());
            set.pieces.push(Piece { id, motion, style });
        }
        Ok(set)
    }
}

/// Loads the recordings of a data folder's training split, for their styles.
///
/// # Errors
/// [`EvaluationError::File`] if it is no data folder, or a file of it can't be read.
pub(crate) fn training_recordings(folder: &Path) -> Result<MotionSet, EvaluationError> {
    let index = Index::open(folder)?
        .ok_or_else(|| EvaluationError::file(folder, "it is no data folder: no index.json"))?;
    index.load(|piece| piece.split == TRAIN_SPLIT)
}

/// The reference: all recordings, and those of two splits.
#[derive(Debug)]
pub(crate) struct Reference {
    pub(crate) folder: PathBuf,
    /// Every recording once.
    pub(crate) whole: MotionSet,
    /// The recordings in the reference's own row.
    pub(crate) test: MotionSet,
    /// The recordings that a model may recite.
    pub(crate) train: MotionSet,
    index: Option<BTreeMap<String, PieceInfo>>,
}

impl Reference {
    /// Reads a data folder, or a folder of motions, which then are their own test pieces.
    pub(crate) fn load(folder: &Path, split: &str) -> Result<Self, EvaluationError> {
        let Some(index) = Index::open(folder)? else {
            let whole = MotionSet::load(folder, split)?;
            return Ok(Self {
                folder: folder.to_owned(),
                test: whole.clone(),
                whole,
                train: MotionSet::default(),
                index: None,
            });
        };
        let whole = index.load(|_| true)?;
        let test = index.load(|piece| piece.split == split)?;
        if test.pieces.is_empty() {
            let problem = format!("it has no recording of split {split}");
            return Err(EvaluationError::file(folder, problem));
        }
        let train = index.load(|piece| piece.split == TRAIN_SPLIT)?;
        let pieces = index.pieces.into_iter();
        Ok(Self {
            folder: folder.to_owned(),
            whole,
            test,
            train,
            index: Some(pieces.map(|piece| (piece.id.clone(), piece)).collect()),
        })
    }

    /// Returns the split of a piece, "" where the reference has no splits.
    ///
    /// # Errors
    /// [`EvaluationError::UnknownPiece`] if it is a data folder without this piece.
    pub(crate) fn split_of(&self, id: &str) -> Result<&str, EvaluationError> {
        match (&self.index, self.info(id)) {
            (_, Some(piece)) => Ok(&piece.split),
            (None, None) => Ok(""),
            (Some(_), None) => Err(EvaluationError::UnknownPiece {
                name: id.to_owned(),
                reference: self.folder.clone(),
            }),
        }
    }

    /// The data folder's entry of a piece.
    pub(crate) fn info(&self, id: &str) -> Option<&PieceInfo> {
        self.index.as_ref()?.get(id)
    }
}
