//! Reading of a motion from any layout.

use bailando::motion::{Positions, Skeleton};

use super::{dataset::MotionSource, error::DataError, json, motion::Motion, npy, smpl};

impl MotionSource {
    /// Reads the motion; rotations are put on `skeleton`.
    ///
    /// # Errors
    /// [`DataError`] names the file and what is wrong with it.
    pub fn load(&self, skeleton: &Skeleton) -> Result<Motion, DataError> {
        self.positions(skeleton).map(Motion::new)
    }

    pub(super) fn positions(&self, skeleton: &Skeleton) -> Result<Positions, DataError> {
        match self {
            Self::Npy(path) => npy::positions(path),
            Self::Json(path) => json::positions(path),
            Self::Pickle(path) => smpl::positions(path, skeleton),
        }
    }
}
