//! Evaluation against golden values, and the command as a user meets it.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    unreachable_pub,
    reason = "a test says what is wrong by failing"
)]

#[path = "evaluation/command.rs"]
mod command;
mod common;
#[path = "evaluation/golden.rs"]
mod golden;
mod motion_support;
#[path = "evaluation/support.rs"]
mod support;
