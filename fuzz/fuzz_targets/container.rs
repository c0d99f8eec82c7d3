//! An upload: container, packets, samples.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = bailando::fuzzing::container(bytes);
});
