//! Tells the container from the bytes, never from a name: an allow-list, with a clear word about
//! the things that people upload by mistake (RELIABILITY, defence 3).

use std::fmt;

use bytes::Bytes;

use super::AudioError;

/// What is accepted, in words for messages.
pub(super) const ACCEPTED: &str = "WAV, FLAC, MP3, Ogg Vorbis and M4A (AAC-LC)";

/// An accepted container.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Container {
    /// RIFF/WAVE with PCM samples.
    Wav,
    /// Native FLAC.
    Flac,
    /// MPEG audio layer III, with or without ID3 tags.
    Mp3,
    /// Ogg with Vorbis.
    Ogg,
    /// ISO base media (MP4) with AAC.
    M4a,
}

impl Container {
    /// Every accepted container.
    pub const ALL: [Self; 5] = [Self::Wav, Self::Flac, Self::Mp3, Self::Ogg, Self::M4a];

    /// Name for programs, with the codec where the container may hold others.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Wav => "wav",
            Self::Flac => "flac",
            Self::Mp3 => "mp3",
            Self::Ogg => "ogg/vorbis",
            Self::M4a => "m4a/aac",
        }
    }
}

impl fmt::Display for Container {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Wav => "WAV",
            Self::Flac => "FLAC",
            Self::Mp3 => "MP3",
            Self::Ogg => "Ogg",
            Self::M4a => "M4A",
        })
    }
}

/// An upload whose container is known.
#[derive(Clone, Debug)]
pub(super) struct Upload {
    pub(super) container: Container,
    /// The container's own bytes: ID3 tags in front and behind are cut off unread, so that no tag
    /// or picture is ever parsed.
    pub(super) bytes: Bytes,
}

/// Finds the container of `bytes`.
pub(super) fn sniff(bytes: &Bytes) -> Result<Upload, AudioError> {
    if bytes.is_empty() {
        return Err(AudioError::Empty);
    }
    let start = id3v2_end(bytes);
    let body = bytes.slice(start..);
    let tagged = start > 0;
    let container = if body.starts_with(b"RIFF") && body.get(8..12) == Some(b"WAVE") {
        Container::Wav
    } else if body.starts_with(b"fLaC") {
        Container::Flac
    } else if body.starts_with(b"OggS") {
        ogg_codec(&body)?;
        Container::Ogg
    } else if body.get(4..8) == Some(b"ftyp") {
        Container::M4a
    } else if let Some(found) = known_but_refused(&body) {
        return Err(AudioError::UnsupportedContainer { found });
    } else if is_mp3(&body, tagged) {
        return Ok(Upload {
            container: Container::Mp3,
            bytes: body.slice(..id3v1_start(&body)),
        });
    } else {
        let found = describe_unknown(&body, tagged);
        return Err(AudioError::UnsupportedContainer { found });
    };
    Ok(Upload {
        container,
        bytes: body,
    })
}

/// End of all ID3v2 tags at the start, at most the length of `bytes`.
fn id3v2_end(bytes: &[u8]) -> usize {
    const HEADER: usize = 10;
    let mut at = 0;
    while let Some(header) = bytes.get(at..at + HEADER) {
        if !header.starts_with(b"ID3") || header[6..].iter().any(|&byte| byte & 0x80 != 0) {
            break;
        }
        // The size is written with 7 bits a byte, without the header and without the footer.
        let size = header[6..]
            .iter()
            .fold(0_usize, |size, &byte| (size << 7) | usize::from(byte));
        let footer = if header[5] & 0x10 != 0 { HEADER } else { 0 };
        at = (at + HEADER + size + footer).min(bytes.len());
    }
    at
}

/// Where an ID3v1 tag at the end starts, else the length of `bytes`.
fn id3v1_start(bytes: &[u8]) -> usize {
    const TAG: usize = 128;
    match bytes.len().checked_sub(TAG) {
        Some(start) if bytes[start..].starts_with(b"TAG") => start,
        _ => bytes.len(),
    }
}

/// Refuses Ogg streams whose first packet is not Vorbis' identification header.
fn ogg_codec(bytes: &[u8]) -> Result<(), AudioError> {
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
    Err(AudioError::UnsupportedCodec {
        container: Container::Ogg,
        codec: codec.to_owned(),
    })
}

/// Words for what is recognised and refused.
fn known_but_refused(bytes: &[u8]) -> Option<&'static str> {
    const MAGIC: [(&[u8], &str); 29] = [
        (b"PK\x03\x04", "a ZIP archive"),
        (b"PK\x05\x06", "an empty ZIP archive"),
        (b"\x1f\x8b", "a gzip file"),
        (b"BZh", "a bzip2 file"),
        (b"\xfd7zXZ", "an xz file"),
        (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive"),
        (b"Rar!", "a RAR archive"),
        (b"\x28\xb5\x2f\xfd", "a Zstandard file"),
        (b"\x89PNG", "a PNG picture"),
        (b"\xff\xd8\xff", "a JPEG picture"),
        (b"GIF8", "a GIF picture"),
        (b"%PDF", "a PDF document"),
        (b"\x1aE\xdf\xa3", "a Matroska or WebM file"),
        (b"FORM", "an AIFF file"),
        (b"caff", "a Core Audio file"),
        (b"RF64", "a 64-bit WAV file (RF64)"),
        (b"BW64", "a 64-bit WAV file (BW64)"),
        (b"riff\x2e\x91\xcf\x11", "a 64-bit WAV file (Sony Wave64)"),
        (b"RIFX", "a big-endian WAV file (RIFX)"),
        (b"RIFF", "a RIFF file that is not WAVE"),
        (b"MThd", "a MIDI file"),
        (b"wvpk", "a WavPack file"),
        (b"MAC ", "a Monkey's Audio file"),
        (b"\x30\x26\xb2\x75", "a Windows Media file"),
        (b"#!AMR", "an AMR file"),
        (b".snd", "a Sun audio file"),
        (b"FLV\x01", "a Flash video"),
        (b"\x7fELF", "a program"),
        (b"\x93NUMPY", "a NumPy array"),
    ];
    MAGIC
        .iter()
        .find(|(magic, _)| bytes.starts_with(magic))
        .map(|&(_, found)| found)
}

/// The length in bytes of the layer III frame whose header starts `bytes`.
fn mp3_frame_length(bytes: &[u8]) -> Option<usize> {
    const KBITS_V1: [usize; 14] = [
        32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320,
    ];
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

/// Whether an MPEG layer III stream starts here. Behind a tag some padding is accepted.
fn is_mp3(bytes: &[u8], tagged: bool) -> bool {
    const SEARCHED_BEHIND_TAG: usize = 64 * 1024;
    const SEARCHED: usize = 4 * 1024;
    let searched = if tagged {
        SEARCHED_BEHIND_TAG
    } else {
        SEARCHED
    };
    let window = &bytes[..searched.min(bytes.len())];
    (0..window.len()).any(|at| {
        if window[at] != 0xff {
            return false;
        }
        let rest = &bytes[at..];
        mp3_frame_length(rest).is_some_and(|length| match rest.get(length..) {
            // Two headers in a row, or (for a stream of one frame) nothing more to compare with.
            Some(next) if next.len() >= 4 => mp3_frame_length(next).is_some(),
            _ => at == 0 || tagged,
        })
    })
}

/// Words for bytes that no rule knows.
fn describe_unknown(bytes: &[u8], tagged: bool) -> &'static str {
    const LOOKED_AT: usize = 512;
    let head = &bytes[..LOOKED_AT.min(bytes.len())];
    let sync = head.len() > 1 && head[0] == 0xff;
    if tagged {
        "an ID3 tag without MP3 audio behind it"
    } else if head.get(4..8).is_some_and(|kind| {
        [b"moov", b"mdat", b"wide", b"free"]
            .iter()
            .any(|known| kind == *known)
    }) {
        "an old QuickTime file without a file type"
    } else if sync && head[1] & 0xf6 == 0xf0 {
        "a raw AAC stream (ADTS)"
    } else if sync && head[1] & 0xe0 == 0xe0 && matches!((head[1] >> 1) & 3, 2 | 3) {
        "MPEG audio of layer I or II"
    } else if head.starts_with(b"<") {
        "an HTML, XML or SVG document"
    } else if head.starts_with(b"{") || head.starts_with(b"[") {
        "a JSON document"
    } else if head
        .iter()
        .all(|&byte| byte >= b' ' || matches!(byte, b'\n' | b'\r' | b'\t'))
    {
        "text"
    } else {
        "an unknown kind of file"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(bytes: &'static [u8]) -> String {
        sniff(&Bytes::from_static(bytes)).unwrap_err().to_string()
    }

    #[test]
    fn refusals_say_what_it_looked_like_and_what_is_accepted() {
        for (bytes, found) in [
            (b"PK\x03\x04rest".as_slice(), "a ZIP archive"),
            (b"\x89PNG\r\n\x1a\n", "a PNG picture"),
            (b"\x1aE\xdf\xa3....", "a Matroska or WebM file"),
            (b"FORM\0\0\0\0AIFF", "an AIFF file"),
            (b"RIFF\0\0\0\0AVI ", "a RIFF file that is not WAVE"),
            (b"RF64\xff\xff\xff\xffWAVE", "a 64-bit WAV file (RF64)"),
            (b"just some words", "text"),
            (b"{\"a\": 1}", "a JSON document"),
            (b"\0", "an unknown kind of file"),
            (b"\xff\xf1\x50\x80", "a raw AAC stream (ADTS)"),
            (b"\xff\xfd\x50\x80", "MPEG audio of layer I or II"),
            (b"ID3\x04\0\0\0\0\0\x02xx", "an ID3 tag without MP3"),
        ] {
            let message = refusal(bytes);
            assert!(message.contains(found), "{message}");
            assert!(message.contains(ACCEPTED), "{message}");
        }
        assert!(matches!(sniff(&Bytes::new()), Err(AudioError::Empty)));
    }

    #[test]
    fn ogg_is_accepted_with_vorbis_only() {
        let page = |packet: &[u8]| {
            let mut page = b"OggS".to_vec();
            page.resize(26, 0);
            page.extend([1, u8::try_from(packet.len()).unwrap()]);
            page.extend(packet);
            Bytes::from(page)
        };
        assert_eq!(
            sniff(&page(b"\x01vorbis....")).unwrap().container,
            Container::Ogg
        );
        let opus = sniff(&page(b"OpusHead....")).unwrap_err();
        assert!(matches!(
            &opus,
            AudioError::UnsupportedCodec { container: Container::Ogg, codec } if codec == "Opus"
        ));
    }

    #[test]
    fn tags_around_mp3_are_cut_off() {
        // MPEG 1 layer III, 128 kbit/s, 44.1 kHz: 417 bytes a frame.
        let mut frame = vec![0xff, 0xfb, 0x90, 0x00];
        frame.resize(417, 0);
        let mut file = b"ID3\x04\0\0\0\0\x01\x00".to_vec();
        file.extend([0xff; 128]);
        file.extend(frame.repeat(3));
        file.extend(b"TAG");
        file.extend([b' '; 125]);
        let upload = sniff(&Bytes::from(file)).unwrap();
        assert_eq!(upload.container, Container::Mp3);
        assert_eq!(upload.bytes, frame.repeat(3));
    }

    #[test]
    fn frame_lengths_follow_the_standard() {
        assert_eq!(mp3_frame_length(&[0xff, 0xfb, 0x90, 0]), Some(417));
        assert_eq!(mp3_frame_length(&[0xff, 0xfb, 0x92, 0]), Some(418));
        // MPEG 2 at 24 kHz and 64 kbit/s: 72 * 64000 / 24000.
        assert_eq!(mp3_frame_length(&[0xff, 0xf3, 0x84, 0]), Some(192));
        assert_eq!(mp3_frame_length(&[0xff, 0xfb, 0x00, 0]), None);
        assert_eq!(mp3_frame_length(&[0xff, 0xfb, 0xf0, 0]), None);
    }
}
