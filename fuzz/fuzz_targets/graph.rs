//! A graph of a model directory, before ONNX Runtime reads it.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = bailando::fuzzing::graph(bytes);
});
