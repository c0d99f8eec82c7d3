//! `bailando`: the server and its command line.

mod cli;

use std::process::ExitCode;

/// The allocator of ONNX Runtime too: it returns the memory of a burst of requests to the system,
/// which the C library's would keep in fragments (docs/operations.md).
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    cli::run()
}
