//! A caller's character: BVH, GLB or VRM.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = bailando::fuzzing::rig(bytes);
});
