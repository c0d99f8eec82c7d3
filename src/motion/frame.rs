//! In which frame a model knows motion.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::{MotionError, facing_columns, to_world_frame};

/// In which frame a model knows motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MotionFrame {
    /// The world's directions, as published: three columns per joint.
    #[default]
    World,
    /// Every pose facing +z, and a last column that turns it ([`super::to_dancer_frame`]).
    Dancer,
}

impl MotionFrame {
    /// Columns that motion of this many joints has.
    #[must_use]
    pub const fn columns(self, joints: usize) -> usize {
        match self {
            Self::World => 3 * joints,
            Self::Dancer => facing_columns(joints),
        }
    }

    /// Whether it is the published frame, which manifests do not mention.
    #[must_use]
    pub fn is_world(&self) -> bool {
        *self == Self::World
    }

    /// A whole piece of motion in this frame as `[frames, 3 joints]` in world directions: turns are
    /// summed from its first frame.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the columns are not those of this frame.
    pub fn into_world(self, motion: Array2<f32>) -> Result<Array2<f32>, MotionError> {
        match self {
            Self::World => Ok(motion),
            Self::Dancer => to_world_frame(motion.view()),
        }
    }
}
