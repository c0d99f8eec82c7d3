//! Frame headers of MPEG audio layer III (ISO 11172-3 section 2.4.1.3).

/// Returns the length in bytes of the layer III frame whose header `bytes` start with.
fn frame_length(bytes: &[u8]) -> Option<usize> {
    const KBITS_V1: [usize; 14] = [32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320];
    const KBITS_V2: [usize; 14] = [8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160];
    let &[sync, version, rates, _] = bytes.first_chunk()?;
    if sync != 0xff || version & 0xe0 != 0xe0 || (version >> 1) & 3 != 1 {
        return None;
    }
    let (rate_shift, kbits, slots) = match (version >> 3) & 3 {
        3 => (0, KBITS_V1, 144_000),
        2 => (1, KBITS_V2, 72_000),
        0 => (2, KBITS_V2, 72_000),
        _ => return None,
    };
    // Index 0 is "free format", which the decoder does not know either; 15 is forbidden.
    let kbit = kbits.get(usize::from(rates >> 4).checked_sub(1)?)?;
    let rate = [44_100, 48_000, 32_000].get(usize::from((rates >> 2) & 3))? >> rate_shift;
    Some(slots * kbit / rate + usize::from((rates >> 1) & 1))
}

/// Returns whether an MPEG layer III stream starts here. After a tag more padding is accepted.
pub(crate) fn starts_stream(bytes: &[u8], tagged: bool) -> bool {
    let searched = if tagged { 64 * 1024 } else { 4 * 1024 };
    let window = &bytes[..searched.min(bytes.len())];
    (0..window.len()).any(|at| {
        if window[at] != 0xff {
            return false;
        }
        let rest = &bytes[at..];
        frame_length(rest).is_some_and(|length| match rest.get(length..) {
            // Two headers in a row, or (for a stream of one frame) nothing more to compare with.
            Some(next) if next.len() >= 4 => frame_length(next).is_some(),
            _ => at == 0 || tagged,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_lengths_follow_the_standard() {
        assert_eq!(frame_length(&[0xff, 0xfb, 0x90, 0]), Some(417));
        assert_eq!(frame_length(&[0xff, 0xfb, 0x92, 0]), Some(418));
        // MPEG 2 at 24 kHz and 64 kbit/s: 72 * 64000 / 24000.
        assert_eq!(frame_length(&[0xff, 0xf3, 0x84, 0]), Some(192));
        assert_eq!(frame_length(&[0xff, 0xfb, 0x00, 0]), None);
        assert_eq!(frame_length(&[0xff, 0xfb, 0xf0, 0]), None);
    }
}
