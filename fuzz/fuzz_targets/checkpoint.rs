//! A PyTorch checkpoint: container, pickle, tensors, networks, graphs.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = bailando_train::fuzzing::checkpoint(bytes);
});
