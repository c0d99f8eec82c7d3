//! `bailando`: the server and its command line.

mod cli;

use std::process::ExitCode;

/// Also that of ONNX Runtime: the memory of a burst of dances is given back, where that of the C library
/// is kept in pieces (docs/operations.md).
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    cli::run()
}
