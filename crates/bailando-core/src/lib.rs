//! Cancellation, vectorised sums and NumPy files, shared by all crates of Bailando.
//!
//! ```
//! use bailando_core::{CancelToken, dsp::dot};
//!
//! let cancel = CancelToken::new();
//! cancel.cancel();
//! assert!(cancel.is_cancelled());
//! assert_eq!(dot(&[1.0, 2.0], &[3.0, 4.0]), 11.0);
//! ```

pub mod cancel;
pub mod dsp;
pub mod npy;

pub use cancel::CancelToken;
