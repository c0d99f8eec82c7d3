//! The handlers: extract, call the engine, respond.

pub(crate) mod codes;
pub(crate) mod docs;
pub(crate) mod generate;
pub(crate) mod jobs;
pub(crate) mod probes;
pub(crate) mod stream;
pub(crate) mod viewer;
