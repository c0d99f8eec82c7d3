//! What Linux says of this process' memory.

use std::fs;

/// What `/proc/self/status` says of the process' memory under `name`, in a unit that does not
/// depend on the size of a page.
pub(crate) fn memory_bytes(name: &str) -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with(name))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(1024 * kibibytes)
}
