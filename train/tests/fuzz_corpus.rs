//! The corpus of the checkpoint fuzz target on any compiler: every file, and mutations of them,
//! through what the target calls.

use std::path::Path;

#[test]
fn checkpoints() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus");
    bailando_testkit::corpus::Corpus::read(&folder, "checkpoint")
        .run(2_000, bailando_train::fuzzing::checkpoint);
}
