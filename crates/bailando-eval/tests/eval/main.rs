//! Evaluation against golden values, and the files that it reads.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    unreachable_pub,
    reason = "a test says what is wrong by failing"
)]

mod files;
mod golden;
mod support;
