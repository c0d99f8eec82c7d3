//! Decoders of packets: symphonia's, and that of Opus, which symphonia lacks.

use symphonia::{
    core::{
        audio::GenericAudioBufferRef,
        codecs::audio::{
            AudioCodecParameters, AudioDecoder, AudioDecoderOptions, CODEC_ID_NULL_AUDIO,
            well_known::{
                CODEC_ID_AAC, CODEC_ID_AC3, CODEC_ID_DCA, CODEC_ID_EAC3, CODEC_ID_MP3,
                CODEC_ID_OPUS, CODEC_ID_VORBIS,
            },
        },
        errors::Error as SymphoniaError,
        packet::Packet,
    },
    default::get_codecs,
};

use crate::{container::Container, error::AudioError, mpeg::Header, opus, packets::refusal};

/// Decodes the packets of one track.
pub(crate) enum Decoder {
    Opus(Box<opus::Decoder>),
    Symphonia(Box<dyn AudioDecoder>),
    /// A decoder of symphonia keeps to the channels and the rate of its first frame: another one is
    /// made where they change.
    Mp3 {
        decoder: Box<dyn AudioDecoder>,
        format: Option<(u32, usize)>,
    },
}

impl Decoder {
    /// Makes a decoder. Trimming is left to it only where packets say how much; see
    /// [`crate::gapless`].
    pub(crate) fn new(
        container: Container,
        parameters: &AudioCodecParameters,
    ) -> Result<Self, AudioError> {
        if parameters.codec == CODEC_ID_OPUS {
            let head = parameters.extra_data.as_deref().unwrap_or_default();
            let decoder = opus::Decoder::new(head).ok_or_else(|| {
                unsupported(container, "Opus with more than 2 channels".to_owned())
            })?;
            return Ok(Self::Opus(Box::new(decoder)));
        }
        let decoder = of_symphonia(parameters).map_err(|error| match error {
            SymphoniaError::Unsupported(what) => {
                unsupported(container, codec_words(parameters, what))
            }
            other => refusal(container, &other),
        })?;
        Ok(if parameters.codec == CODEC_ID_MP3 {
            Self::Mp3 { decoder, format: None }
        } else {
            Self::Symphonia(decoder)
        })
    }

    /// Decodes a packet.
    pub(crate) fn decode(
        &mut self,
        packet: &Packet,
    ) -> Result<GenericAudioBufferRef<'_>, SymphoniaError> {
        match self {
            Self::Opus(decoder) => decoder.decode(packet),
            Self::Symphonia(decoder) => decoder.decode(packet),
            Self::Mp3 { decoder, format } => {
                let header = Header::read(&packet.data);
                let new = header.map(|header| (header.hz, header.channels));
                if format.is_some() && *format != new {
                    *decoder = of_symphonia(&decoder.codec_params().clone())?;
                }
                *format = new;
                decoder.decode(packet)
            }
        }
    }
}

fn of_symphonia(
    parameters: &AudioCodecParameters,
) -> Result<Box<dyn AudioDecoder>, SymphoniaError> {
    let trims = parameters.codec == CODEC_ID_VORBIS;
    let options = AudioDecoderOptions::default().gapless(trims);
    match core_of(parameters) {
        Some(core) => {
            let mut parameters = parameters.clone();
            parameters.with_extra_data(core);
            get_codecs().make_audio_decoder(&parameters, &options)
        }
        None => get_codecs().make_audio_decoder(parameters, &options),
    }
}

/// Returns a warning about what the decoder leaves out.
pub(crate) fn note(parameters: &AudioCodecParameters) -> Option<String> {
    core_of(parameters).map(|_| {
        "the file is HE-AAC: its core is used, without the upper half of the frequencies".to_owned()
    })
}

/// Returns the configuration of the LC core where that of the file (ISO 14496-3 section 1.6.2.1)
/// says that the stream is HE-AAC, which is an LC stream at half the rate and additions to it.
fn core_of(parameters: &AudioCodecParameters) -> Option<Box<[u8]>> {
    const LC: u64 = 2;
    const SBR: u64 = 5;
    const PARAMETRIC_STEREO: u64 = 29;
    let config = parameters.extra_data.as_deref().filter(|_| parameters.codec == CODEC_ID_AAC)?;
    let mut bits = Bits { bytes: config, at: 0 };
    let kind = bits.read(5)?;
    if kind != SBR && kind != PARAMETRIC_STEREO {
        return None;
    }
    let rate = bits.rate()?;
    let channels = bits.read(4)?;
    bits.rate()?;
    if bits.read(5)? != LC {
        return None;
    }
    // An index of 15 is followed by the rate itself; 3 bits for frames of 1024 samples end it.
    let (rate_bits, rate) = rate;
    let core = ((((LC << rate_bits) | rate) << 4) | channels) << 3;
    let length = 5 + rate_bits + 4 + 3;
    let bytes = (core << (64 - length)).to_be_bytes();
    Some(bytes[..length.div_ceil(8)].into())
}

/// Reads bits from the highest one on.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn read(&mut self, count: usize) -> Option<u64> {
        let mut value = 0;
        for _ in 0..count {
            let byte = self.bytes.get(self.at / 8)?;
            value = (value << 1) | u64::from((byte >> (7 - self.at % 8)) & 1);
            self.at += 1;
        }
        Some(value)
    }

    /// Reads a sample rate; returns its bits and their number.
    fn rate(&mut self) -> Option<(usize, u64)> {
        match self.read(4)? {
            15 => Some((28, (15 << 24) | self.read(24)?)),
            index => Some((4, index)),
        }
    }
}

fn unsupported(container: Container, codec: String) -> AudioError {
    AudioError::UnsupportedCodec { container, codec }
}

/// Names a codec: symphonia names only those it was built with.
fn codec_words(parameters: &AudioCodecParameters, reason: &str) -> String {
    let words = match parameters.codec {
        CODEC_ID_AAC => "AAC of another profile than LC and HE-AAC, or with more than 2 channels",
        CODEC_ID_AC3 | CODEC_ID_EAC3 => "Dolby Digital (AC-3)",
        CODEC_ID_DCA => "DTS",
        CODEC_ID_NULL_AUDIO => "an unknown codec",
        other => {
            return match get_codecs().get_audio_decoder(other) {
                Some(decoder) => format!(
                    "{} in a form that is not supported ({reason})",
                    decoder.codec.info.long_name
                ),
                None => format!("a codec without a decoder here (number {other})"),
            };
        }
    };
    words.to_owned()
}
