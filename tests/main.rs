//! The integration tests of the service: one binary, for each links everything.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test that fails panics, in its helpers as well"
)]

mod choices;
mod cli;
mod cli_rig;
mod dance;
mod docs;
mod engine;
mod evaluation;
mod fuzz_corpus;
mod server;
mod support;
mod taste;
