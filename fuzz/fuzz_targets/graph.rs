//! A graph of a model directory, before ONNX Runtime reads it.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = bailando_model::graph_is_accepted(bytes);
});
