//! Detects the container from the bytes, never from a name: an allow-list, with a clear word about
//! the files that people upload by mistake (RELIABILITY, defence 3).

use bytes::Bytes;

use crate::{
    container::Container, ebml, error::AudioError, flac, id3, mp4, mpeg, ogg_page, riff,
    upload::Upload,
};

/// Returns whether a file that starts with `prefix` is WAV, AIFF or FLAC: large by nature;
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
    (body.len() >= MAGIC).then(|| riff::is_wav(body) || riff::is_aiff(body) || is_flac(body))
}

fn is_flac(body: &[u8]) -> bool {
    body.starts_with(b"fLaC")
}

/// Detects the container of `bytes`.
pub(crate) fn sniff(bytes: &Bytes) -> Result<Upload, AudioError> {
    if bytes.is_empty() {
        return Err(AudioError::Empty);
    }
    let tag = id3::v2_end(bytes).min(bytes.len());
    if let Some(upload) = of_container(&bytes.slice(tag..)) {
        return upload;
    }
    if let Some(found) = known_but_refused(&bytes[tag..]) {
        return Err(AudioError::UnsupportedContainer { found });
    }
    if let Some(upload) = mp3(bytes, tag) {
        return Ok(upload);
    }
    let rest = &bytes[tag..];
    if mpeg::is_free_format(&rest[zeros(rest)..]) {
        return Err(AudioError::UnsupportedCodec {
            container: Container::Mp3,
            codec: "frames in free format, which do not state their bit rate".to_owned(),
        });
    }
    let found = describe_unknown(rest, bytes.starts_with(b"ID3"));
    Err(AudioError::UnsupportedContainer { found })
}

/// Reads a container that is known by its first bytes.
fn of_container(body: &Bytes) -> Option<Result<Upload, AudioError>> {
    let plain = |container| Ok(Upload::new(container, body.clone()));
    Some(if riff::is_wav(body) {
        riff::wav(body)
    } else if riff::is_aiff(body) {
        riff::aiff(body)
    } else if is_flac(body) {
        Ok(flac::repaired(body.slice(..id3::v1_start(body))))
    } else if body.starts_with(ogg_page::MARK) {
        plain(Container::Ogg)
    } else if body.starts_with(ebml::MARK) {
        plain(Container::Webm)
    } else if mp4::is_movie(body) {
        plain(Container::M4a)
    } else {
        return None;
    })
}

/// Finds MP3 after the tag that ends at `tag`, after one of a wrong size, and after other bytes.
fn mp3(bytes: &Bytes, tag: usize) -> Option<Upload> {
    /// Bytes that are searched for frames: large pictures fit into a tag of this length.
    const REACH: usize = 8 << 20;
    let start_at = |at: usize| {
        let body = bytes.get(at..)?;
        let at = at + zeros(body);
        mpeg::starts_stream(bytes.get(at..)?).then_some(at)
    };
    let found = start_at(tag)
        .or_else(|| id3::plain_v2_end(bytes).and_then(start_at))
        .or_else(|| mpeg::find_stream(bytes, REACH))?;
    let body = bytes.slice(found..);
    let mut upload = Upload::new(Container::Mp3, body.slice(..id3::v1_start(&body)));
    if found != tag {
        let skipped = found.abs_diff(tag);
        upload.assumed.push(if bytes.starts_with(b"ID3") {
            format!(
                "the ID3 tag states a wrong size: the music starts {skipped} bytes {} its end",
                if found > tag { "after" } else { "before" }
            )
        } else {
            format!("{skipped} bytes in front of the first MP3 frame were skipped")
        });
    }
    Some(upload)
}

/// Returns the number of zeros at the start.
fn zeros(bytes: &[u8]) -> usize {
    bytes.iter().position(|&byte| byte != 0).unwrap_or(bytes.len())
}

/// Names files that are recognised and refused.
fn known_but_refused(bytes: &[u8]) -> Option<&'static str> {
    const MAGIC: [(&[u8], &str); 26] = [
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
        (b"FORM", "an IFF file that is not AIFF"),
        (b"caff", "a Core Audio file"),
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
            (b"FORM\0\0\0\08SVX", "an IFF file that is not AIFF"),
            (b"RIFF\0\0\0\0AVI ", "a RIFF file that is not WAVE"),
            (b"RIFX\0\0\0\0WAVE", "a big-endian WAV file (RIFX)"),
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
        assert_eq!(upload.assumed, Vec::<String>::new());
    }

    #[test]
    fn free_format_is_named() {
        let mut frame = vec![0xff, 0xfb, 0x00, 0x00];
        frame.resize(700, 0x11);
        let error = sniff(&Bytes::from(frame.repeat(8))).unwrap_err().to_string();
        assert!(error.contains("free format"), "{error}");
    }
}
