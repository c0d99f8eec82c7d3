//! Jobs as the service keeps them: whose they are, what was ordered, what became of it.

pub(crate) mod options;
pub(crate) mod order;
pub(crate) mod owners;
mod room;
pub(crate) mod service;
pub(crate) mod song;
pub(crate) mod status;
pub(crate) mod storage;
