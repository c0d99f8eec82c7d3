//! The query of a request, tails included.
#![no_main]

use std::sync::LazyLock;

use bailando_model::Manifest;
use libfuzzer_sys::fuzz_target;

static MODEL: LazyLock<Manifest> = LazyLock::new(|| {
    let text = include_str!("../../tests/fixtures/model/tiny_dancer/manifest.json");
    serde_json::from_str(text).expect("a manifest")
});

fuzz_target!(|bytes: &[u8]| {
    let _ = bailando::fuzzing::options(bytes, &MODEL);
});
