//! What the stages take in, and a plain reader of our own data folder.

use std::path::Path;

use bailando::{
    CancelToken,
    audio::{self, AudioLimits, AudioRange},
    features::{FeatureExtractor, Profile, Rate},
};
use ndarray::{Array2, Array3};
use serde::Deserialize;

use super::TrainError;

/// Columns of a motion frame.
const COLUMNS: usize = 72;

/// A dance and the music beside it.
#[derive(Clone, Debug)]
pub struct MotionPiece {
    /// Whether it is of the test split.
    pub test: bool,
    /// `[frames, 72]` at 60 fps: the root's velocity (metres per frame) in columns 0..2, the other
    /// joints relative to the root, as the decoder gives them (ARCHITECTURE section 2).
    pub motion: Array2<f32>,
    /// `[rows, columns]` features, row `k` at frame `8 k`; empty where music was not asked for.
    pub music: Array2<f32>,
}

impl MotionPiece {
    /// From joints in world space, `[frames, 24, 3]` metres.
    #[must_use]
    pub fn from_positions(positions: &Array3<f32>, music: Array2<f32>, test: bool) -> Self {
        let frames = positions.shape().first().copied().unwrap_or(0);
        let motion = Array2::from_shape_fn((frames, COLUMNS), |(frame, column)| {
            let (joint, axis) = (column / 3, column % 3);
            let root = |frame: usize| positions[[frame, 0, axis]];
            if joint > 0 {
                return positions[[frame, joint, axis]] - root(frame);
            }
            // The last velocity is the one before it, repeated.
            let from = frame.min(frames.saturating_sub(2));
            root((from + 1).min(frames - 1)) - root(from)
        });
        Self {
            test,
            motion,
            music,
        }
    }
}

/// The pieces of a data set.
#[derive(Clone, Debug, Default)]
pub struct MotionSet {
    /// Both splits.
    pub pieces: Vec<MotionPiece>,
}

/// What is needed of a data folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// Dances alone.
    Motion,
    /// The songs' features as well.
    Music(Profile),
}

#[derive(Deserialize)]
struct Index {
    pieces: Vec<Entry>,
}

#[derive(Deserialize)]
struct Entry {
    split: String,
    motion: String,
    audio: String,
}

impl MotionSet {
    /// Reads `index.json` and what it names; the test split is left out.
    ///
    /// # Errors
    /// [`TrainError`] names the first file that cannot be used.
    pub fn read(folder: &Path, load: Load) -> Result<Self, TrainError> {
        let path = folder.join("index.json");
        let bytes = std::fs::read(&path).map_err(TrainError::file(&path))?;
        let index: Index = serde_json::from_slice(&bytes).map_err(|error| data(&path, error))?;
        let mut extractor = match load {
            Load::Motion => None,
            Load::Music(profile) => Some(FeatureExtractor::new(Rate::Conditioning, profile)),
        };
        let mut pieces = Vec::new();
        for entry in index.pieces.iter().filter(|entry| entry.split == "train") {
            let path = folder.join(&entry.motion);
            let positions: Array3<f32> =
                ndarray_npy::read_npy(&path).map_err(|error| data(&path, error))?;
            if positions.shape().get(1..) != Some(&[COLUMNS / 3, 3]) {
                let found = positions.shape();
                return Err(data(
                    &path,
                    format!("expected [frames, 24, 3], found {found:?}"),
                ));
            }
            if positions.iter().any(|value| !value.is_finite()) {
                return Err(data(&path, "holds values that are no numbers"));
            }
            let music = match &mut extractor {
                Some(extractor) => features(&folder.join(&entry.audio), extractor)?,
                None => Array2::zeros((0, 0)),
            };
            pieces.push(MotionPiece::from_positions(&positions, music, false));
        }
        Ok(Self { pieces })
    }

    /// The pieces that may be learned from.
    pub fn training(&self) -> impl Iterator<Item = &MotionPiece> {
        self.pieces.iter().filter(|piece| !piece.test)
    }
}

fn features(path: &Path, extractor: &mut FeatureExtractor) -> Result<Array2<f32>, TrainError> {
    let bytes = std::fs::read(path).map_err(TrainError::file(path))?;
    let decoded = audio::decode(
        bytes.into(),
        AudioRange::default(),
        &[extractor.rate().hz()],
        &AudioLimits::default(),
        &CancelToken::new(),
    );
    let decoded = decoded.map_err(|error| data(path, error))?;
    let signal = decoded.signals.first().map_or(&[][..], Vec::as_slice);
    extractor.extract(signal).map_err(|error| data(path, error))
}

fn data(path: &Path, message: impl std::fmt::Display) -> TrainError {
    TrainError::Data {
        path: path.to_owned(),
        message: message.to_string(),
    }
}
