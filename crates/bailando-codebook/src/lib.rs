#![doc = include_str!("../README.md")]

mod catalogue;
mod error;
mod figure;
mod half;
mod heading;
mod memory;
mod page;
mod pose;
mod sheet;
mod still;
mod transition;
mod uses;

pub use catalogue::{Catalogue, CodePose, HalfCodes, Nearest};
pub use error::CodebookError;
pub use half::Half;
pub use memory::{CodeUses, MEMORY_FILE, Memory};
pub use sheet::Order;
pub use transition::Transition;
pub use uses::Uses;
