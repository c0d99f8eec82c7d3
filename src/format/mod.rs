//! Dances as files: JSON and BVH.

mod error;

pub use error::FormatError;
