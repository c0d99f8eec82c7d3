//! WebM and Matroska files (RFC 9559): the packets of the first audio track that can be decoded.
//! Elements are read in one pass and none is looked up, so that recordings that a browser streamed
//! (without sizes, without a length, without an index) are read like any other.

use std::collections::VecDeque;

use bytes::Bytes;
use symphonia::core::{
    audio::Channels,
    codecs::audio::{
        AudioCodecId, AudioCodecParameters,
        well_known::{
            CODEC_ID_AAC, CODEC_ID_FLAC, CODEC_ID_MP3, CODEC_ID_OPUS, CODEC_ID_PCM_F32LE,
            CODEC_ID_PCM_F64LE, CODEC_ID_PCM_S16BE, CODEC_ID_PCM_S16LE, CODEC_ID_PCM_S24BE,
            CODEC_ID_PCM_S24LE, CODEC_ID_PCM_S32BE, CODEC_ID_PCM_S32LE, CODEC_ID_PCM_U8,
            CODEC_ID_VORBIS,
        },
    },
    errors::Error as SymphoniaError,
    packet::{Packet, PacketBuilder},
    units::{Duration, Timestamp},
};

use crate::{
    container::Container,
    ebml::{self, Element},
    error::AudioError,
    flac,
    mpeg::Header,
    opus,
    packets::{PacketReader, TrackInfo, end_of_file},
    vorbis::Blocks,
};

/// What is read of a track.
#[derive(Clone, Debug, Default)]
struct Entry {
    number: u64,
    is_audio: bool,
    codec: String,
    private: Vec<u8>,
    hz: f64,
    channels: u64,
    bits: u64,
    /// Nanoseconds of lead-in.
    delay_ns: u64,
    /// Its packets are compressed or encrypted once more.
    encoded: bool,
}

impl Entry {
    /// Samples of lead-in.
    fn lead_in(&self, hz: u32) -> u64 {
        (self.delay_ns as f64 * 1e-9 * f64::from(hz)).round() as u64
    }

    /// The codec of plain samples.
    fn pcm(&self) -> Option<AudioCodecId> {
        Some(match (self.codec.as_str(), self.bits) {
            ("A_PCM/INT/LIT", 8) => CODEC_ID_PCM_U8,
            ("A_PCM/INT/LIT", 16) => CODEC_ID_PCM_S16LE,
            ("A_PCM/INT/LIT", 24) => CODEC_ID_PCM_S24LE,
            ("A_PCM/INT/LIT", 32) => CODEC_ID_PCM_S32LE,
            ("A_PCM/INT/BIG", 16) => CODEC_ID_PCM_S16BE,
            ("A_PCM/INT/BIG", 24) => CODEC_ID_PCM_S24BE,
            ("A_PCM/INT/BIG", 32) => CODEC_ID_PCM_S32BE,
            ("A_PCM/FLOAT/IEEE", 32) => CODEC_ID_PCM_F32LE,
            ("A_PCM/FLOAT/IEEE", 64) => CODEC_ID_PCM_F64LE,
            _ => return None,
        })
    }
}

/// How long a packet lasts, from its own bytes.
#[derive(Debug)]
enum Codec {
    Opus,
    Vorbis(Option<Blocks>),
    Aac,
    Mp3,
    Flac,
    /// Bytes of a sample of all channels.
    Pcm(u64),
}

/// Reads the packets of one track.
#[derive(Debug)]
pub(crate) struct WebmReader {
    file: Bytes,
    at: usize,
    number: u64,
    hz: u32,
    codec: Codec,
    ready: VecDeque<Packet>,
    time: Timestamp,
    skip: u64,
    ended: bool,
}

impl WebmReader {
    /// Reads everything before the first cluster.
    pub(crate) fn open(file: &Bytes) -> Result<(Self, TrackInfo), AudioError> {
        let (entries, at) = read_entries(file)?;
        let entry = choose(&entries)?;
        let mut parameters = AudioCodecParameters::new();
        let (mut hz, mut skip) = (entry.hz.round() as u32, 0);
        let codec = match entry.codec.as_str() {
            "A_OPUS" => {
                hz = opus::HZ;
                skip = opus::Head::read(&entry.private).map_or(0, |head| head.pre_skip);
                parameters.for_codec(CODEC_ID_OPUS);
                Codec::Opus
            }
            "A_VORBIS" => {
                parameters.for_codec(CODEC_ID_VORBIS);
                Codec::Vorbis(
                    ebml::laced_headers(&entry.private)
                        .and_then(|headers| Blocks::new(headers.first()?, headers.get(2)?)),
                )
            }
            "A_FLAC" => {
                parameters.for_codec(CODEC_ID_FLAC);
                Codec::Flac
            }
            "A_MPEG/L3" => {
                skip = entry.lead_in(hz);
                parameters.for_codec(CODEC_ID_MP3);
                Codec::Mp3
            }
            "A_AAC" => {
                skip = entry.lead_in(hz);
                parameters.for_codec(CODEC_ID_AAC);
                Codec::Aac
            }
            _ => {
                parameters.for_codec(entry.pcm().unwrap_or(CODEC_ID_PCM_S16LE));
                parameters.with_channels(Channels::Discrete(entry.channels as u16));
                Codec::Pcm((entry.channels * entry.bits / 8).max(1))
            }
        };
        // Of FLAC's metadata the decoder wants the stream information alone.
        let private = match codec {
            Codec::Flac => entry.private.get(8..42).unwrap_or_default(),
            _ => entry.private.as_slice(),
        };
        parameters.with_sample_rate(hz).with_extra_data(private.into());
        let mut track = TrackInfo::new(0, parameters, hz);
        // These are trimmed after decoding: their packets do not say where the sound starts.
        if matches!(codec, Codec::Aac | Codec::Mp3) && skip > 0 {
            track.delay = u32::try_from(skip).ok();
            skip = 0;
        }
        let reader = Self {
            file: file.clone(),
            at,
            number: entry.number,
            hz,
            codec,
            ready: VecDeque::new(),
            time: Timestamp::ZERO,
            skip,
            ended: false,
        };
        Ok((reader, track))
    }

    /// Reads the next element.
    fn step(&mut self) -> Result<(), SymphoniaError> {
        let file = self.file.clone();
        let Some(element) = Element::read(&file, self.at) else {
            self.ended = true;
            self.at = file.len();
            return Err(end_of_file());
        };
        self.at = element.next();
        match element.id {
            ebml::SIMPLE_BLOCK | ebml::BLOCK => {
                let Some(block) = element.body(&file) else {
                    self.ended = true;
                    return Err(end_of_file());
                };
                if block_track(block) == Some(self.number) {
                    let packets = ebml::unlace(block);
                    let packets = packets
                        .ok_or(SymphoniaError::DecodeError("webm: block with impossible sizes"))?;
                    packets.into_iter().for_each(|packet| self.push(packet));
                }
            }
            ebml::DISCARD_PADDING => {
                let nanoseconds = element.body(&file).map_or(0, ebml::signed);
                self.discard(nanoseconds);
            }
            _ => {}
        }
        Ok(())
    }

    fn push(&mut self, data: &[u8]) {
        let duration = match &mut self.codec {
            Codec::Opus => opus::duration(data),
            Codec::Vorbis(blocks) => blocks.as_mut().map_or(0, |blocks| blocks.duration(data)),
            Codec::Aac => 1_024,
            Codec::Mp3 => Header::read(data).map_or(0, |header| header.samples.into()),
            Codec::Flac => flac::frame_samples(data),
            Codec::Pcm(bytes) => data.len() as u64 / *bytes,
        };
        let front = self.skip.min(duration);
        self.skip -= front;
        let kept = Duration::new(duration - front);
        let packet = PacketBuilder::new()
            .track_id(0)
            .pts(self.time)
            .dur(kept)
            .trim_start(Duration::new(front))
            .data(data)
            .build();
        self.time = self.time.saturating_add(kept);
        self.ready.push_back(packet);
    }

    /// Takes the padding of the last packet off its end.
    fn discard(&mut self, nanoseconds: i64) {
        let samples = (nanoseconds.max(0) as f64 * 1e-9 * f64::from(self.hz)).round() as u64;
        if let Some(packet) = self.ready.back_mut() {
            let end = packet.dur.get().min(samples);
            packet.dur = Duration::new(packet.dur.get() - end);
            packet.trim_end = Duration::new(end);
        }
    }
}

impl PacketReader for WebmReader {
    fn next_packet(&mut self) -> Result<Option<Packet>, SymphoniaError> {
        // One packet is held back: what follows a block may shorten it.
        while self.ready.len() < 2 && !self.ended {
            if self.at >= self.file.len() {
                self.ended = true;
            } else if let Err(error) = self.step() {
                if self.ready.is_empty() || !self.ended {
                    return Err(error);
                }
                // The end comes after the packets that are ready.
                self.at = usize::MAX;
            }
        }
        match self.ready.pop_front() {
            None if self.at > self.file.len() => Err(end_of_file()),
            packet => Ok(packet),
        }
    }
}

/// Reads the entries of all tracks; returns them with the position of the first cluster.
fn read_entries(file: &[u8]) -> Result<(Vec<Entry>, usize), AudioError> {
    const MOST_TRACKS: usize = 64;
    const MOST_CHANNELS: u64 = 255;
    let (mut at, mut entries) = (0, Vec::<Entry>::new());
    while let Some(element) = Element::read(file, at) {
        if element.id == ebml::CLUSTER {
            return Ok((entries, at));
        }
        at = element.next();
        if element.id == ebml::TRACK_ENTRY {
            if entries.len() == MOST_TRACKS {
                return Err(malformed("it has more than 64 tracks"));
            }
            entries.push(Entry { hz: 8_000.0, channels: 1, ..Entry::default() });
        }
        let (Some(entry), Some(body)) = (entries.last_mut(), element.body(file)) else { continue };
        match element.id {
            ebml::TRACK_NUMBER => entry.number = ebml::unsigned(body),
            ebml::TRACK_TYPE => entry.is_audio = ebml::unsigned(body) == 2,
            ebml::CODEC_ID => {
                let text = String::from_utf8_lossy(body.get(..64).unwrap_or(body));
                entry.codec = text.trim_end_matches('\0').to_owned();
            }
            ebml::CODEC_PRIVATE => entry.private = body.to_vec(),
            ebml::CODEC_DELAY => entry.delay_ns = ebml::unsigned(body),
            ebml::CHANNELS => entry.channels = ebml::unsigned(body).min(MOST_CHANNELS),
            ebml::BIT_DEPTH => entry.bits = ebml::unsigned(body),
            ebml::SAMPLING_FREQUENCY => entry.hz = ebml::float(body),
            ebml::CONTENT_ENCODINGS => entry.encoded = true,
            _ => {}
        }
    }
    Err(malformed("it ends before its first audio"))
}

/// Returns the first track that can be decoded, or names what is there instead.
fn choose(entries: &[Entry]) -> Result<&Entry, AudioError> {
    let audio = || entries.iter().filter(|entry| entry.is_audio);
    let readable = |entry: &&Entry| match entry.codec.as_str() {
        _ if entry.encoded => false,
        "A_OPUS" => opus::Head::read(&entry.private).is_some(),
        "A_VORBIS" | "A_AAC" | "A_FLAC" | "A_MPEG/L3" => true,
        _ => entry.pcm().is_some(),
    };
    audio().find(readable).ok_or_else(|| AudioError::UnsupportedCodec {
        container: Container::Webm,
        codec: match audio().next() {
            None => "no audio track".to_owned(),
            Some(entry) if entry.encoded => {
                "audio that is compressed or encrypted again".to_owned()
            }
            Some(entry) if entry.codec == "A_OPUS" => "Opus with more than 2 channels".to_owned(),
            Some(entry) => format!("the codec {:?}", entry.codec),
        },
    })
}

fn block_track(block: &[u8]) -> Option<u64> {
    ebml::vint(block, 0).map(|(number, _)| number)
}

fn malformed(reason: &str) -> AudioError {
    AudioError::Malformed { container: Container::Webm, reason: reason.to_owned() }
}
