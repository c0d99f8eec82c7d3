//! The page structure of Ogg files (RFC 3533).

use crate::{container::Container, error::AudioError};

/// Refuses a file whose first packet is not Vorbis' identification header.
pub(crate) fn check_codec(bytes: &[u8]) -> Result<(), AudioError> {
    const SEGMENT_COUNT: usize = 26;
    let packet = bytes
        .get(SEGMENT_COUNT)
        .and_then(|&segments| bytes.get(SEGMENT_COUNT + 1 + usize::from(segments)..))
        .unwrap_or_default();
    let codec = match packet {
        p if p.starts_with(b"\x01vorbis") => return Ok(()),
        p if p.starts_with(b"OpusHead") => "Opus",
        p if p.starts_with(b"\x7fFLAC") => "FLAC (send it as a native .flac file)",
        p if p.starts_with(b"Speex") => "Speex",
        p if p.starts_with(b"\x80theora") => "Theora video",
        p if p.len() < b"OpusHead".len() => {
            return Err(AudioError::Malformed {
                container: Container::Ogg,
                reason: "it ends inside its first page".to_owned(),
            });
        }
        _ => "an unknown codec",
    };
    Err(AudioError::UnsupportedCodec { container: Container::Ogg, codec: codec.to_owned() })
}

/// Returns whether the file ends with a whole page that is marked as the last one: nothing else in
/// an Ogg file says that it was cut.
pub(crate) fn is_whole(bytes: &[u8]) -> bool {
    const HEADER: usize = 27;
    const MAX_PAGE: usize = HEADER + 255 + 255 * 255;
    const LAST_PAGE: u8 = 4;
    let tail = &bytes[bytes.len().saturating_sub(MAX_PAGE)..];
    let Some(start) = tail.windows(4).rposition(|part| part == b"OggS") else {
        return false;
    };
    let page = &tail[start..];
    let Some((header, rest)) = page.split_at_checked(HEADER) else {
        return false;
    };
    let segments = usize::from(header[HEADER - 1]);
    let length = rest.get(..segments).map(|sizes| {
        let body: usize = sizes.iter().map(|&size| usize::from(size)).sum();
        HEADER + segments + body
    });
    header[5] & LAST_PAGE != 0 && length.is_some_and(|length| page.len() >= length)
}
