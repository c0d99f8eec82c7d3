//! Why a skeleton or motion is not usable.

/// The reason why a skeleton or motion is not usable.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// The skeleton's tables contradict each other.
    #[error("skeleton: {0}")]
    Skeleton(String),
    /// A figure is no humanoid that could dance.
    #[error("the figure cannot dance: {0}")]
    Figure(String),
    /// An array does not have the expected shape.
    #[error("expected {expected}, got {got}")]
    Shape {
        /// Shape that was expected.
        expected: String,
        /// Shape that was found.
        got: String,
    },
    /// The motion holds a NaN or an infinity.
    #[error("the motion is not finite at frame {frame}, joint {joint}")]
    NotFinite {
        /// First frame concerned.
        frame: usize,
        /// First joint concerned in that frame.
        joint: usize,
    },
    /// The frame rate is not one of those offered.
    #[error("fps {got} is not available: choose one of 20, 24, 30, 60")]
    FrameRate {
        /// Frame rate that was asked for.
        got: u32,
    },
    /// The decoder's own positions are wanted of a motion that is not its own.
    #[error(
        "the decoder's own positions are available at {decoded_fps} frames a second and without \
         clean-up only"
    )]
    DecoderPositions {
        /// Frames per second of the decoder's output.
        decoded_fps: u32,
    },
}
