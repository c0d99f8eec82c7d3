//! The HTTP service, in process: through the router, and through a socket where it matters.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that fails panics, in its helpers as well"
)]

mod client;
mod fake;
mod generate;
mod lifecycle;
mod limits;
#[cfg(unix)]
mod process;
mod real;
mod surface;
#[path = "../audio/writers.rs"]
mod writers;
