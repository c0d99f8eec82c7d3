//! The frame of reference in which a model knows motion.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::{
    error::MotionError,
    heading::{dancer_columns, turn_from},
};

/// The frame of reference in which a model knows motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MotionFrame {
    /// The world's directions, as published: three columns per joint.
    #[default]
    World,
    /// Every pose heading for +z, and a last column that turns it ([`crate::to_dancer_frame`]).
    Dancer,
}

impl MotionFrame {
    /// Returns the number of columns of a motion of so many joints.
    #[must_use]
    pub const fn columns(self, joints: usize) -> usize {
        match self {
            Self::World => 3 * joints,
            Self::Dancer => dancer_columns(joints),
        }
    }

    /// Whether it is the published frame, which manifests do not mention.
    #[must_use]
    pub fn is_world(&self) -> bool {
        *self == Self::World
    }

    /// Turns a whole motion in this frame into `[frames, 3 joints]` in world directions: turns are
    /// summed from its first frame.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the columns are not those of this frame.
    pub fn into_world(self, motion: Array2<f32>) -> Result<Array2<f32>, MotionError> {
        ToWorld::new(self, 0.0).push(motion)
    }
}

/// A converter of one motion into world directions, piece by piece.
#[derive(Clone, Copy, Debug)]
pub struct ToWorld {
    frame: MotionFrame,
    heading: f64,
}

impl ToWorld {
    /// Creates a converter for motion in `frame` whose first pose has this heading, in radians
    /// about +y from +z.
    #[must_use]
    pub fn new(frame: MotionFrame, heading: f64) -> Self {
        Self { frame, heading }
    }

    /// Converts the next frames to `[frames, 3 joints]` in world directions.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the columns are not those of the frame.
    pub fn push(&mut self, motion: Array2<f32>) -> Result<Array2<f32>, MotionError> {
        match self.frame {
            MotionFrame::World => Ok(motion),
            MotionFrame::Dancer => turn_from(motion.view(), &mut self.heading),
        }
    }

    /// Returns the heading of the next frame, in radians; the first heading in the world's frame.
    #[must_use]
    pub fn heading(&self) -> f64 {
        self.heading
    }
}
