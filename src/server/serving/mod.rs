//! The life of the server: listening, connections, draining, stopping.

mod connection;
pub(crate) mod cut;
#[cfg(unix)]
mod descriptors;
mod heads;
mod idle_stream;
pub(crate) mod lifecycle;
mod places;
mod serve;
mod signals;

pub use self::serve::{ServeError, Service, run, start};
