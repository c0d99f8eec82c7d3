//! The integration tests of the trainer: one binary, for each links everything.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests: failing loudly is their job"
)]

mod common;
#[path = "../src/data/testing.rs"]
mod testing;

mod check_data;
mod checkpoints;
mod command;
mod compare;
mod encode;
mod export;
mod fuzz_corpus;
mod generate;
#[cfg(unix)]
mod kill;
mod music_gap;
mod networks;
mod policy;
mod sample;
mod strangers;
mod tiny_models;
mod training;
mod training_data;
