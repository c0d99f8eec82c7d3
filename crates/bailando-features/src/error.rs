//! Why features could not be computed.

/// The reason why features could not be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FeatureError {
    /// The delta stage needs three rows (FEATURES section 3).
    #[error(
        "the audio is too short for music features: it gives {rows} feature rows, at least \
         {needed} are needed"
    )]
    TooShort {
        /// Rows that the signal gives.
        rows: usize,
        /// Rows that are needed.
        needed: usize,
    },
    /// A sample is infinite or not a number.
    #[error("sample {index} of the signal is not a finite number")]
    NotFinite {
        /// Index of the first such sample.
        index: usize,
    },
    /// A sample is so large that its power would overflow.
    #[error("sample {index} of the signal is {value:e}; full scale is 1")]
    OutOfRange {
        /// Index of the first such sample.
        index: usize,
        /// Its value.
        value: f32,
    },
    /// A beat network did not give probabilities for each row.
    #[error(
        "the beat network gave activations of shape {shape:?} for {rows} rows, expected \
         probabilities of shape ({rows}, 3)"
    )]
    Activations {
        /// Rows that it was given.
        rows: usize,
        /// The shape of what it gave.
        shape: (usize, usize),
    },
    /// The caller's token was cancelled.
    #[error("the features were cancelled")]
    Cancelled,
}
