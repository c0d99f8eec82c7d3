//! In which frame a model knows motion.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::{MotionError, facing::turn_on, facing_columns};

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
        ToWorld::new(self, 0.0).push(motion)
    }
}

/// Brings the motion of one dance into world directions, piece by piece.
#[derive(Clone, Copy, Debug)]
pub struct ToWorld {
    frame: MotionFrame,
    facing: f64,
}

impl ToWorld {
    /// For motion in `frame`, whose first pose faces `facing` radians about +y from +z.
    #[must_use]
    pub fn new(frame: MotionFrame, facing: f64) -> Self {
        Self { frame, facing }
    }

    /// The next frames, `[frames, 3 joints]` in world directions.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the columns are not those of the frame.
    pub fn push(&mut self, motion: Array2<f32>) -> Result<Array2<f32>, MotionError> {
        match self.frame {
            MotionFrame::World => Ok(motion),
            MotionFrame::Dancer => turn_on(motion.view(), &mut self.facing),
        }
    }

    /// Where the next frame faces, in radians; the first facing where the frame is the world's.
    #[must_use]
    pub fn facing(&self) -> f64 {
        self.facing
    }
}
