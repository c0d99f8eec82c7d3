//! Bounds of ID3 tags, which are cut off unread: no tag or picture is ever parsed.

const HEADER: usize = 10;

/// Returns the end of all ID3v2 tags at the start (ID3v2.4 section 3.1), 0 without one. The end
/// exceeds the length of `bytes` that hold only a part of the last tag.
pub(crate) fn v2_end(bytes: &[u8]) -> usize {
    let mut at = 0_usize;
    while let Some(header) = bytes.get(at..at.saturating_add(HEADER)) {
        if !header.starts_with(b"ID3") || header[6..].iter().any(|&byte| byte & 0x80 != 0) {
            break;
        }
        // The size has 7 bits a byte and counts neither the header nor the footer.
        let size = header[6..].iter().fold(0_usize, |size, &byte| (size << 7) | usize::from(byte));
        let footer = if header[5] & 0x10 != 0 { HEADER } else { 0 };
        at += HEADER + size + footer;
    }
    at
}

/// Returns the end of the tag at the start if its size were a plain number of 32 bits, as some
/// programs write it.
pub(crate) fn plain_v2_end(bytes: &[u8]) -> Option<usize> {
    let header: &[u8; HEADER] = bytes.first_chunk()?;
    let size = [header[6], header[7], header[8], header[9]];
    header.starts_with(b"ID3").then(|| HEADER + u32::from_be_bytes(size) as usize)
}

/// Returns the start of an ID3v1 tag at the end, or the length of `bytes`.
pub(crate) fn v1_start(bytes: &[u8]) -> usize {
    const TAG: usize = 128;
    match bytes.len().checked_sub(TAG) {
        Some(start) if bytes[start..].starts_with(b"TAG") => start,
        _ => bytes.len(),
    }
}
