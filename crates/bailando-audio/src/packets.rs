//! What all readers of packets have in common: the packets, the track they belong to, and the words
//! for what keeps a file from being read.

use std::{
    io::{self, ErrorKind},
    num::NonZero,
};

use symphonia::core::{
    codecs::audio::AudioCodecParameters, errors::Error as SymphoniaError, formats::FormatReader,
    packet::Packet, units::TimeBase,
};

use crate::{container::Container, error::AudioError};

/// Reads packets one by one, symphonia's readers as well as those of this crate.
pub(crate) trait PacketReader {
    /// Returns the next packet; `None` at the end.
    fn next_packet(&mut self) -> Result<Option<Packet>, SymphoniaError>;
}

impl PacketReader for Box<dyn FormatReader> {
    fn next_packet(&mut self) -> Result<Option<Packet>, SymphoniaError> {
        self.as_mut().next_packet()
    }
}

/// The error of a file that ends too early.
pub(crate) fn end_of_file() -> SymphoniaError {
    SymphoniaError::IoError(io::Error::from(ErrorKind::UnexpectedEof))
}

/// Properties of the audio track as the file declares them; no memory is reserved for them.
#[derive(Clone, Debug)]
pub(crate) struct TrackInfo {
    pub(crate) id: u32,
    pub(crate) parameters: AudioCodecParameters,
    pub(crate) time_base: Option<TimeBase>,
    /// Frames declared, without encoder delay and padding.
    pub(crate) frames: Option<u64>,
    /// Encoder delay in frames (the LAME tag of MP3).
    pub(crate) delay: Option<u32>,
    /// Encoder padding in frames (the LAME tag of MP3).
    pub(crate) padding: Option<u32>,
}

impl TrackInfo {
    /// Describes a track whose times count in samples.
    pub(crate) fn new(id: u32, parameters: AudioCodecParameters, hz: u32) -> Self {
        let time_base = NonZero::new(hz).map(TimeBase::from_recip);
        Self { id, parameters, time_base, frames: None, delay: None, padding: None }
    }

    /// Returns the seconds that a packet says it lasts.
    pub(crate) fn seconds(&self, packet: &Packet) -> f64 {
        self.time_base.map_or(0.0, |base| {
            packet.dur.get() as f64 * f64::from(base.numer.get()) / f64::from(base.denom.get())
        })
    }
}

/// Translates an error of reading the headers.
pub(crate) fn refusal(container: Container, error: &SymphoniaError) -> AudioError {
    match error {
        SymphoniaError::IoError(error) if error.kind() == ErrorKind::UnexpectedEof => {
            AudioError::Malformed { container, reason: "it ends inside its header".to_owned() }
        }
        SymphoniaError::Unsupported(what) if what.contains("missing") => {
            AudioError::Malformed { container, reason: (*what).to_owned() }
        }
        SymphoniaError::Unsupported(what) => AudioError::UnsupportedCodec {
            container,
            codec: format!("something unsupported ({what})"),
        },
        other => AudioError::Malformed { container, reason: other.to_string() },
    }
}
