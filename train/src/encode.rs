//! Encoding of recordings with a served model's pose VQ-VAE, and their reconstruction.

use std::path::{Path, PathBuf};

use bailando::{
    model::{ModelDirectory, ModelError},
    motion::{MotionError, MotionFrame, integrate_root, to_dancer_frame},
};
use clap::Args;
use ndarray::{Array2, Axis, Slice};

use crate::data::{DataError, Dataset, JOINTS, Motion, OpenOptions, Portion, Split, SplitKind};

/// The recordings to encode, and the folder to write.
#[derive(Args, Clone, Debug)]
pub struct EncodeOptions {
    /// Model directory
    #[arg(long = "model-dir", default_value = "models/default", value_name = "DIR")]
    pub model: PathBuf,
    /// Data folder of any layout
    #[arg(skip)]
    pub data: PathBuf,
    /// Folder to write to
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Which recordings
    #[arg(long, value_enum, default_value_t = Split::Test)]
    pub split: Split,
    /// Also write the decoded motion
    #[arg(long)]
    pub reconstruct: bool,
}

/// Why recordings could not be encoded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages are the documentation")]
pub enum EncodeError {
    #[error(transparent)]
    Data(#[from] DataError),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Motion(#[from] MotionError),
    #[error("no recording of this split has music")]
    NoMusic,
    #[error("{}: {message}", path.display())]
    Write { path: PathBuf, message: String },
}

impl EncodeError {
    fn write(path: &Path, error: impl std::fmt::Display) -> Self {
        Self::Write { path: path.to_owned(), message: error.to_string() }
    }
}

/// Writes `<id>.codes.npy` (int64 `[2, codes]`, upper and lower) of every recording of a split, and
/// with `reconstruct` the decoded `<id>.npy` (float32 `[frames, 24, 3]`, the root starting where
/// the recording's does). A recording of several pieces goes by the first one's id. Returns how
/// many.
///
/// # Errors
/// [`EncodeError`] of the first that fails.
pub fn encode(options: &EncodeOptions) -> Result<usize, EncodeError> {
    let dataset = Dataset::open(&options.data, &OpenOptions::default())?;
    match options.split {
        Split::Train => encode_portion(&dataset.training()?, options),
        Split::Test => encode_portion(&dataset.evaluation()?, options),
    }
}

fn encode_portion<S: SplitKind>(
    portion: &Portion<S>,
    options: &EncodeOptions,
) -> Result<usize, EncodeError> {
    let directory = ModelDirectory::open(&options.model)?;
    let frame = directory.manifest().motion_frame;
    let (mut encoder, mut decoder) = (directory.encoder(1)?, directory.decoder(1)?);
    std::fs::create_dir_all(&options.out)
        .map_err(|error| EncodeError::write(&options.out, error))?;
    for dance in portion.recordings() {
        let motion = dance.motion(portion.skeleton())?;
        let pairs = encoder.encode(columns(&motion, frame)?.view())?;
        let id = dance.songs().first().map_or("recording", |song| song.id.as_str());
        let codes =
            Array2::from_shape_fn((2, pairs.len()), |(half, place)| i64::from(pairs[place][half]));
        let path = options.out.join(format!("{id}.codes.npy"));
        ndarray_npy::write_npy(&path, &codes).map_err(|error| EncodeError::write(&path, error))?;
        if options.reconstruct {
            let decoded = frame.into_world(decoder.decode(&pairs)?)?;
            let start = std::array::from_fn(|axis| motion.positions()[[0, 0, axis]]);
            let positions = integrate_root(decoded.view(), start)?;
            let path = options.out.join(format!("{id}.npy"));
            ndarray_npy::write_npy(&path, &positions)
                .map_err(|error| EncodeError::write(&path, error))?;
        }
    }
    Ok(portion.recordings().len())
}

/// Returns the encoder's input, `[frames, 72]`.
pub(crate) fn columns(motion: &Motion, frame: MotionFrame) -> Result<Array2<f32>, MotionError> {
    Ok(match frame {
        MotionFrame::World => motion.root_relative(),
        MotionFrame::Dancer => {
            let columns = to_dancer_frame(motion.positions())?;
            let joints = Slice::from(..3 * JOINTS);
            columns.slice_axis(Axis(1), joints).to_owned()
        }
    })
}
