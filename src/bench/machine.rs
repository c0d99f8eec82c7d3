//! The machine and the memory of the process. Known on Linux; elsewhere the fields stay empty.

use std::{fs, num::NonZeroUsize, thread};

use super::report::Machine;
use crate::resident::memory_bytes;

pub(super) fn describe() -> Machine {
    let cpu = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let named = |name: &str| {
        let line = cpu.lines().find(|line| line.starts_with(name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    let flags = named("flags").unwrap_or_default();
    let vectors = ["avx2", "avx512f", "avx512_vnni", "amx_int8"];
    let has = |flag: &&str| flags.split_whitespace().any(|found| found == *flag);
    Machine {
        cpu: named("model name").unwrap_or_default(),
        vectors: vectors.into_iter().filter(has).map(str::to_owned).collect(),
        cores: thread::available_parallelism().map_or(1, NonZeroUsize::get),
        system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
    }
}

/// Memory of the process now.
pub(super) fn resident_bytes() -> Option<u64> {
    memory_bytes("VmRSS:")
}

/// Most memory of the process so far.
pub(super) fn peak_bytes() -> Option<u64> {
    memory_bytes("VmHWM:")
}
