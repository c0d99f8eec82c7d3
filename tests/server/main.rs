//! The HTTP service, in process: through the router, and through a socket where it matters.

mod client;
mod fake;
mod generate;
mod lifecycle;
mod limits;
mod surface;
