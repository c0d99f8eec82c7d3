//! What every request passes before and after its handler.

pub(crate) mod auth;
pub(crate) mod client;
pub(crate) mod cors;
pub(crate) mod envelope;
mod host;
mod rate_limit;
