//! Opus (RFC 6716, RFC 7845), decoded by the crate `rusty-opus`.

use rusty_opus::OpusDecoder;
use symphonia::core::{
    audio::{
        AsGenericAudioBufferRef, Audio, AudioBuffer, AudioMut, AudioSpec, GenericAudioBufferRef,
        layouts,
    },
    errors::Error as SymphoniaError,
    packet::Packet,
};

/// Samples a second of every Opus stream.
pub(crate) const HZ: u32 = 48_000;
/// Samples in 120 ms, the longest packet.
const LONGEST: usize = 5_760;

/// The identification header (RFC 7845 section 5.1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Head {
    pub(crate) channels: usize,
    /// Samples to drop in front.
    pub(crate) pre_skip: u64,
    /// Factor for the output.
    gain: f32,
}

impl Head {
    /// Reads a header; `None` where it is none, or one of a mapping for more than two channels.
    pub(crate) fn read(bytes: &[u8]) -> Option<Self> {
        let &[version, channels, skip_low, skip_high, _, _, _, _, gain_low, gain_high, mapping] =
            bytes.strip_prefix(b"OpusHead")?.first_chunk()?;
        if version > 15 || mapping > 1 || !(1..=2).contains(&channels) {
            return None;
        }
        let gain = f32::from(i16::from_le_bytes([gain_low, gain_high])) / 256.0;
        Some(Self {
            channels: usize::from(channels),
            pre_skip: u64::from(u16::from_le_bytes([skip_low, skip_high])),
            gain: 10_f32.powf(gain / 20.0),
        })
    }
}

/// Returns the samples that a packet decodes to (RFC 6716 section 3.1), 0 for an impossible one.
pub(crate) fn duration(packet: &[u8]) -> u64 {
    let Some(&toc) = packet.first() else { return 0 };
    let frame = match toc >> 3 {
        config @ 0..12 => [480, 960, 1_920, 2_880][usize::from(config % 4)],
        config @ 12..16 => [480, 960][usize::from(config % 2)],
        config => [120, 240, 480, 960][usize::from(config % 4)],
    };
    let frames = match toc & 3 {
        0 => 1,
        1 | 2 => 2,
        _ => packet.get(1).map_or(0, |count| u64::from(count & 0x3f)),
    };
    let samples = frame * frames;
    if samples <= LONGEST as u64 { samples } else { 0 }
}

/// Decodes the packets of one stream.
pub(crate) struct Decoder {
    inner: OpusDecoder,
    gain: f32,
    interleaved: Vec<f32>,
    buffer: AudioBuffer<f32>,
}

impl Decoder {
    /// Makes a decoder of a stream with this header; `None` for a header that is not read.
    pub(crate) fn new(head: &[u8]) -> Option<Self> {
        let head = Head::read(head)?;
        let layout = match head.channels {
            1 => layouts::CHANNEL_LAYOUT_MONO,
            _ => layouts::CHANNEL_LAYOUT_STEREO,
        };
        Some(Self {
            inner: OpusDecoder::new(HZ as i32, head.channels).ok()?,
            gain: head.gain,
            interleaved: vec![0.0; LONGEST * head.channels],
            buffer: AudioBuffer::new(AudioSpec::new(HZ, layout), LONGEST),
        })
    }

    /// Decodes a packet and trims it as the packet says.
    pub(crate) fn decode(
        &mut self,
        packet: &Packet,
    ) -> Result<GenericAudioBufferRef<'_>, SymphoniaError> {
        self.buffer.clear();
        // An empty packet asks the decoder to invent sound; here it is a lost one.
        if duration(&packet.data) == 0 {
            return Err(SymphoniaError::DecodeError("opus: packet without audio"));
        }
        let samples = self
            .inner
            .decode(&packet.data, LONGEST, &mut self.interleaved)
            .map_err(|_| SymphoniaError::DecodeError("opus: damaged packet"))?
            .min(LONGEST);
        self.buffer.render_uninit(Some(samples));
        let channels = self.buffer.num_planes();
        for channel in 0..channels {
            let Some(plane) = self.buffer.plane_mut(channel) else { continue };
            let decoded = self.interleaved.iter().skip(channel).step_by(channels);
            for (sample, decoded) in plane.iter_mut().zip(decoded) {
                *sample = decoded * self.gain;
            }
        }
        let frames = |trim: u64| usize::try_from(trim).unwrap_or(usize::MAX).min(samples);
        let (front, end) = (frames(packet.trim_start.get()), frames(packet.trim_end.get()));
        self.buffer.trim(front, end.min(samples - front));
        Ok(self.buffer.as_generic_audio_buffer_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_follow_the_first_byte() {
        // SILK 60 ms; hybrid 10 ms twice; CELT 2.5 ms; 20 ms six times.
        assert_eq!(duration(&[3 << 3]), 2_880);
        assert_eq!(duration(&[(12 << 3) | 1]), 960);
        assert_eq!(duration(&[16 << 3]), 120);
        assert_eq!(duration(&[(31 << 3) | 3, 6]), 5_760);
        assert_eq!(duration(&[(31 << 3) | 3, 7]), 0, "more than 120 ms");
        assert_eq!(duration(&[(31 << 3) | 3]), 0);
        assert_eq!(duration(&[]), 0);
    }

    #[test]
    fn headers_of_one_and_two_channels_are_read() {
        let mut head = b"OpusHead\x01\x02\x38\x01\x80\xbb\0\0\0\x06\0".to_vec();
        let read = Head::read(&head).unwrap();
        assert_eq!((read.channels, read.pre_skip), (2, 312));
        assert!((read.gain - 1.995).abs() < 1e-3, "6 dB: {}", read.gain);
        head[9] = 6;
        assert_eq!(Head::read(&head), None);
    }
}
