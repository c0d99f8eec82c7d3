//! Detects the container from the bytes, never from a name: an allow-list, with a clear word about
//! the files that people upload by mistake (RELIABILITY, defence 3).

use bytes::Bytes;

use crate::{container::Container, error::AudioError, id3, mpeg, ogg};

/// An upload whose container is known.
#[derive(Clone, Debug)]
pub(crate) struct Upload {
    pub(crate) container: Container,
    /// The container's own bytes, without ID3 tags in front and after the audio.
    pub(crate) bytes: Bytes,
}

/// Returns whether a file that starts with `prefix` is WAV or FLAC, which are large by nature;
/// ID3v2 tags in front are stepped over. `None`: more bytes are needed.
///
/// ```
/// use bailando_audio::is_lossless;
///
/// assert_eq!(is_lossless(b"fLa"), None);
/// assert_eq!(is_lossless(b"fLaC\0\0\0\x22\0\0\0\0"), Some(true));
/// assert_eq!(is_lossless(b"OggS\0\x02\0\0\0\0\0\0"), Some(false));
/// ```
#[must_use]
pub fn is_lossless(prefix: &[u8]) -> Option<bool> {
    const MAGIC: usize = 12;
    let body = prefix.get(id3::v2_end(prefix)..)?;
    (body.len() >= MAGIC).then(|| is_wav(body) || is_flac(body))
}

fn is_wav(body: &[u8]) -> bool {
    body.starts_with(b"RIFF") && body.get(8..12) == Some(b"WAVE")
}

fn is_flac(body: &[u8]) -> bool {
    body.starts_with(b"fLaC")
}

/// Detects the container of `bytes`.
pub(crate) fn sniff(bytes: &Bytes) -> Result<Upload, AudioError> {
    if bytes.is_empty() {
        return Err(AudioError::Empty);
    }
    let start = id3::v2_end(bytes).min(bytes.len());
    let mut body = bytes.slice(start..);
    let tagged = start > 0;
    let container = if is_wav(&body) {
        Container::Wav
    } else if is_flac(&body) {
        Container::Flac
    } else if body.starts_with(b"OggS") {
        ogg::check_codec(&body)?;
        Container::Ogg
    } else if body.get(4..8) == Some(b"ftyp") {
        Container::M4a
    } else if let Some(found) = known_but_refused(&body) {
        return Err(AudioError::UnsupportedContainer { found });
    } else if mpeg::starts_stream(&body, tagged) {
        body.truncate(id3::v1_start(&body));
        Container::Mp3
    } else {
        let found = describe_unknown(&body, tagged);
        return Err(AudioError::UnsupportedContainer { found });
    };
    Ok(Upload { container, bytes: body })
}

/// Names files that are recognised and refused.
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
    MAGIC.iter().find(|(magic, _)| bytes.starts_with(magic)).map(|&(_, found)| found)
}

/// Describes bytes that no rule knows.
fn describe_unknown(bytes: &[u8], tagged: bool) -> &'static str {
    const LOOKED_AT: usize = 512;
    let head = &bytes[..LOOKED_AT.min(bytes.len())];
    let sync = head.len() > 1 && head[0] == 0xff;
    if tagged {
        "an ID3 tag without MP3 audio after it"
    } else if head
        .get(4..8)
        .is_some_and(|kind| [b"moov", b"mdat", b"wide", b"free"].iter().any(|known| kind == *known))
    {
        "an old QuickTime file without a file type"
    } else if sync && head[1] & 0xf6 == 0xf0 {
        "a raw AAC stream (ADTS)"
    } else if sync && head[1] & 0xe0 == 0xe0 && matches!((head[1] >> 1) & 3, 2 | 3) {
        "MPEG audio of layer I or II"
    } else if head.starts_with(b"<") {
        "an HTML, XML or SVG document"
    } else if head.starts_with(b"{") || head.starts_with(b"[") {
        "a JSON document"
    } else if head.iter().all(|&byte| byte >= b' ' || matches!(byte, b'\n' | b'\r' | b'\t')) {
        "text"
    } else {
        "an unknown kind of file"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::container::ACCEPTED;

    #[test]
    fn lossless_files_are_known_by_their_first_bytes_even_after_a_tag() {
        for body in [b"RIFF\x01\x02\x03\x04WAVE", b"fLaC\0\0\0\x22\0\0\0\0"] {
            let tagged = [b"ID3\x04\0\0\0\0\0\x02xx".as_slice(), body].concat();
            assert_eq!(is_lossless(body), Some(true));
            assert_eq!(is_lossless(&tagged), Some(true));
            for length in 0..tagged.len() {
                assert_eq!(is_lossless(&tagged[..length]), None, "{length} bytes");
            }
        }
        let other = b"RIFF\x01\x02\x03\x04AVI ";
        assert_eq!(is_lossless(other), Some(false));
        let tag = b"ID3\x04\0\0\0\0\0\x02xx".as_slice();
        assert_eq!(is_lossless(&[tag, tag, other].concat()), Some(false));
    }

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
        assert_eq!(sniff(&page(b"\x01vorbis....")).unwrap().container, Container::Ogg);
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
}
