//! `/jobs`: dances that are asked for now and fetched later.

pub(crate) mod create;
pub(crate) mod events;
mod find;
mod last_words;
pub(crate) mod manage;
mod range;
pub(crate) mod result;
