//! Training data: three layouts behind one [`Dataset`], splits kept apart by type, motion as the
//! networks take it (ARCHITECTURE section 1), music rows computed by `bailando` and cached.
//!
//! [`Dataset::open`] → [`Dataset::training`] (or [`Dataset::evaluation`]) → [`Portion`]:
//! [`CropPlan::round`] draws crops, [`Recording::motion`] and [`MusicLibrary`] fill them.
//! [`mod@check`] says in plain words what is wrong with a folder, [`convert`] makes one of motion
//! capture.

mod aist;
mod audio;
mod augment;
mod body;
mod cache;
pub mod check;
pub mod convert;
mod crops;
mod dataset;
mod error;
mod files;
mod folder;
mod json;
mod library;
mod load;
mod marks;
mod motion;
mod npy;
mod open;
mod portion;
mod quantise;
mod several;
mod skeletons;
mod smpl;
mod songs;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod tracker;

#[cfg(test)]
pub(crate) use augment::mirrored;
pub use augment::{PHASES, mirrored_column};
pub use cache::{FeatureCache, FeatureKey};
pub use crops::{Choice, CropPlan, Draw, common_frames, crop_starts, rows_beside};
pub use dataset::{Dataset, Defect, Layout, MotionSource, MusicSource, OpenOptions, Piece, Split};
pub use error::DataError;
pub use library::{KnownCounts, MusicLibrary};
pub use marks::{Marks, Phrase};
pub use motion::Motion;
pub use portion::{Evaluation, Portion, Recording, Song, SplitKind, Training};
pub use quantise::quantised;
pub use several::DataFolder;

/// Frames per second of all motion.
pub const FPS: usize = 60;
/// Joints of all motion, SMPL order.
pub const JOINTS: usize = 24;
/// Frames that one pose code stands for.
pub const FRAMES_PER_CODE: usize = 8;
