//! All integration tests of the trainer: one binary, for each links everything.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests: failing loudly is their job"
)]

mod common;
#[path = "../src/data/testing.rs"]
mod testing;

mod batch;
mod batching;
mod check_data;
mod codebook;
mod command;
mod compare;
mod dancer_frame;
mod default_model;
mod encode;
mod fuzz_corpus;
mod generate;
mod golden;
#[cfg(unix)]
mod kill;
mod music_gap;
mod networks;
mod policy;
mod sampling;
mod strangers;
mod training;
mod training_data;
