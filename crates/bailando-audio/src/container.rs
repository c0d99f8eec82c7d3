//! The containers that are accepted.

use std::fmt;

/// The accepted formats, in words for messages.
pub(crate) const ACCEPTED: &str =
    "WAV, AIFF, FLAC, MP3, Ogg and WebM (Vorbis, Opus) and M4A (AAC-LC, ALAC)";

/// Names of the accepted formats for programs, with the codec where a container may hold several.
pub const FORMATS: [&str; 10] = [
    "wav",
    "aiff",
    "flac",
    "mp3",
    "ogg/vorbis",
    "ogg/opus",
    "webm/vorbis",
    "webm/opus",
    "m4a/aac",
    "m4a/alac",
];

/// An accepted container.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Container {
    /// RIFF/WAVE and RF64 with PCM or ADPCM samples.
    Wav,
    /// AIFF and AIFF-C with PCM samples.
    Aiff,
    /// Native FLAC.
    Flac,
    /// MPEG audio layer III, with or without ID3 tags.
    Mp3,
    /// Ogg with Vorbis, Opus or FLAC.
    Ogg,
    /// WebM and Matroska with Vorbis, Opus, AAC, MP3, FLAC or PCM.
    Webm,
    /// ISO base media (MP4) and QuickTime with AAC, ALAC, Opus or PCM.
    M4a,
}

impl fmt::Display for Container {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Wav => "WAV",
            Self::Aiff => "AIFF",
            Self::Flac => "FLAC",
            Self::Mp3 => "MP3",
            Self::Ogg => "Ogg",
            Self::Webm => "WebM or Matroska",
            Self::M4a => "M4A",
        })
    }
}
