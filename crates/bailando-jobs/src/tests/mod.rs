//! The same tests for each database.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that fails panics")]

mod files;
mod jobs;
mod migrations;
