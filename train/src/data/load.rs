//! Reading of a motion from any layout.

use bailando::motion::{Positions, Skeleton};

use super::{dataset::MotionSource, error::DataError, json, motion::Motion, npy, smpl};

impl MotionSource {
    /// Reads the motion; rotations are put on `skeleton`.
    ///
    /// # Errors
    /// [`DataError`] names the file and what is wrong with it; [`DataError::NotFinite`] the frame.
    pub fn load(&self, skeleton: &Skeleton) -> Result<Motion, DataError> {
        let positions = self.positions(skeleton)?;
        match broken_frame(&positions) {
            Some(frame) => Err(DataError::NotFinite { path: self.path().to_owned(), frame }),
            None => Ok(Motion::new(positions)),
        }
    }

    pub(super) fn positions(&self, skeleton: &Skeleton) -> Result<Positions, DataError> {
        match self {
            Self::Npy(path) => npy::positions(path),
            Self::Json(path) => json::positions(path),
            Self::Pickle(path) => smpl::positions(path, skeleton),
        }
    }
}

/// Returns the first frame with a value that is no number.
pub(super) fn broken_frame(positions: &Positions) -> Option<usize> {
    positions.outer_iter().position(|pose| pose.iter().any(|value| !value.is_finite()))
}
