//! The containers that are accepted.

use std::fmt;

/// The accepted formats, in words for messages.
pub(crate) const ACCEPTED: &str = "WAV, FLAC, MP3, Ogg Vorbis and M4A (AAC-LC)";

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
