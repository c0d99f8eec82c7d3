//! An upload: container, packets, samples.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = bailando_audio::fuzzing::container(bytes);
});
