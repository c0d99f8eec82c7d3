//! Small files that claim or hold far too much.

use super::*;

fn peak_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[test]
fn ten_hours_of_silence_are_refused_at_once() {
    let hours = 36_000 * 48_000;
    for (channels, declared) in [(1, hours), (8, hours), (8, 0), (8, 48_000)] {
        let bytes = SilentFlac { rate: 48_000, channels, frames: hours, declared }.bytes();
        let (size, before, start) = (bytes.len(), peak_kib(), Instant::now());
        let error = refusal(bytes);
        let elapsed = start.elapsed();
        println!("{size} bytes, {channels} channels, declares {declared}: {elapsed:?}, {error}");
        assert!(matches!(error, AudioError::TooLong { .. }), "{error}");
        assert!(elapsed < Duration::from_millis(500), "{elapsed:?}");
        // Other tests of this process allocate as well, far below the 64 MiB allowed.
        if let (Some(before), Some(after)) = (before, peak_kib()) {
            assert!(after.saturating_sub(before) < 64 * 1024, "{before} to {after} KiB");
        }
    }
}

#[test]
fn tables_that_list_the_same_bytes_again_and_again_end() {
    // The size of every sample is one number when the table's own number is not 0: all samples
    // of the M4A become 2 kB long, more than the file holds in all.
    let mut file = fixture("demo.m4a");
    let table = file.windows(4).position(|part| part == b"stsz").unwrap();
    file[table + 8..table + 12].copy_from_slice(&2_000_u32.to_be_bytes());
    file[table + 12..table + 16].copy_from_slice(&4_000_000_u32.to_be_bytes());
    let start = Instant::now();
    let error = refusal(file);
    println!("{error}");
    assert!(start.elapsed() < Duration::from_millis(500));
}

#[test]
fn declared_sizes_reserve_nothing() {
    let start = Instant::now();
    let error = refusal(wav_declaring(1, 44_100, 16, &[0; 980], 2_000_000_000));
    assert!(matches!(error, AudioError::TooShort { .. }), "{error}");
    let few = SilentFlac { rate: 44_100, channels: 8, frames: 65_535, declared: 0xf_ffff_ffff };
    assert!(matches!(refusal(few.bytes()), AudioError::TooLong { .. }));
    assert!(start.elapsed() < Duration::from_millis(500));
}
