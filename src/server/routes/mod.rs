//! The handlers: extract, call the engine, respond.

pub(crate) mod generate;
pub(crate) mod probes;
