//! Helpers of the integration tests.

use std::path::PathBuf;

/// Path of shared test material: `BAILANDO_SHARED`, default `../shared` beside the workspace.
/// `None` (with one line on standard output) when neither is there; a missing file inside it is
/// the caller's failure.
#[allow(
    dead_code,
    reason = "not every integration test binary uses every helper"
)]
pub fn shared(relative: &str) -> Option<PathBuf> {
    let root = match std::env::var_os("BAILANDO_SHARED") {
        Some(root) => PathBuf::from(root),
        None => {
            let default = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared");
            if !default.is_dir() {
                println!("skipped: needs {relative} of BAILANDO_SHARED");
                return None;
            }
            default
        }
    };
    Some(root.join(relative))
}
