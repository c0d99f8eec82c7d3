//! The life of the server: listening, connections, draining, stopping.

mod connection;
mod idle_stream;
pub(crate) mod lifecycle;
mod serve;
mod signals;

pub use self::serve::{ServeError, Service, run, start};
