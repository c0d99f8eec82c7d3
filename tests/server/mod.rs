//! The HTTP service in process: through the router, and through a socket where that matters.

mod access;
mod client;
mod connection;
mod durable;
mod fake;
mod generate;
mod guard;
mod guard_http2;
mod jobs;
mod lifecycle;
mod limits;
mod loops;
#[cfg(unix)]
mod process;
mod real;
mod replicas;
mod rig;
mod streaming;
mod surface;
mod uploads;
mod viewer;
