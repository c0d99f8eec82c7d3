//! Ogg files (RFC 3533): the packets of the first Vorbis, Opus or FLAC stream. Others are skipped,
//! and a page without a time stamp costs nothing: a packet's duration is read from itself.

use std::collections::VecDeque;

use bytes::Bytes;
use symphonia::core::{
    codecs::audio::{
        AudioCodecParameters,
        well_known::{CODEC_ID_FLAC, CODEC_ID_OPUS, CODEC_ID_VORBIS},
    },
    errors::Error as SymphoniaError,
    packet::{Packet, PacketBuilder},
    units::{Duration, Timestamp},
};

use crate::{
    container::Container,
    error::AudioError,
    flac,
    ogg_page::{self, Page},
    opus,
    packets::{PacketReader, TrackInfo, end_of_file},
    vorbis::Blocks,
};

/// Silence put in the place of lost pages is at most this long; a longer jump is a cut.
const LONGEST_GAP_S: i64 = 30;

/// First bytes of a FLAC stream's header packet; then come a version, the number of further header
/// packets, and the beginning of a native file.
const FLAC: &[u8] = b"\x7fFLAC";
/// Bytes of that packet in front of a native file.
const FLAC_PREFIX: usize = 9;

/// The kind of a stream and what its packets' durations need.
#[derive(Debug)]
enum Codec {
    Vorbis(Option<Blocks>),
    Opus,
    /// Its header packet is a native file's beginning after nine bytes.
    Flac,
}

/// Reads the packets of one stream.
#[derive(Debug)]
pub(crate) struct OggReader {
    file: Bytes,
    at: usize,
    serial: u32,
    hz: u32,
    codec: Codec,
    /// A packet that the next page continues.
    partial: Option<Vec<u8>>,
    sequence: Option<u32>,
    /// Packets of the pages read so far.
    ready: VecDeque<Packet>,
    headers: Vec<Vec<u8>>,
    /// Header packets that have not come yet.
    headers_left: usize,
    /// Time stamp of the stream, where one is known.
    position: Option<i64>,
    /// Time of the next packet in the output.
    time: Timestamp,
    /// Samples still to be dropped in front.
    skip: u64,
    /// The stream's last page has come.
    complete: bool,
}

impl OggReader {
    /// Reads the headers of the first stream that can be decoded.
    pub(crate) fn open(file: &Bytes) -> Result<(Self, TrackInfo), AudioError> {
        let (serial, codec) = choose(file)?;
        let headers_left = match codec {
            Codec::Vorbis(_) => 3,
            Codec::Opus => 2,
            // How many blocks of metadata follow need not be said; they are no frames.
            Codec::Flac => 1,
        };
        let mut reader = Self {
            file: file.clone(),
            at: 0,
            serial,
            hz: opus::HZ,
            codec,
            partial: None,
            sequence: None,
            ready: VecDeque::new(),
            headers: Vec::new(),
            headers_left,
            position: None,
            time: Timestamp::ZERO,
            skip: 0,
            complete: false,
        };
        while reader.headers_left > 0 {
            match reader.read_page() {
                Ok(true) => {}
                Ok(false) => return Err(malformed("it ends inside its header")),
                Err(error) => return Err(malformed(&error.to_string())),
            }
        }
        let track = reader.track()?;
        Ok((reader, track))
    }

    /// Takes from the headers what the packets need.
    fn begin(&mut self) {
        let first = self.headers.first().map(Vec::as_slice).unwrap_or_default();
        match &mut self.codec {
            Codec::Opus => self.skip = opus::Head::read(first).map_or(0, |head| head.pre_skip),
            Codec::Vorbis(blocks) => {
                *blocks = self.headers.get(2).and_then(|setup| Blocks::new(first, setup));
                let hz = first.get(12..).and_then(|hz| hz.first_chunk());
                self.hz = hz.map_or(0, |hz| u32::from_le_bytes(*hz));
            }
            Codec::Flac => {
                let native = first.get(FLAC_PREFIX..).unwrap_or_default();
                self.hz = flac::stream_info(native).map_or(0, |(hz, ..)| hz);
            }
        }
    }

    /// Describes the stream from its headers.
    fn track(&mut self) -> Result<TrackInfo, AudioError> {
        let headers = std::mem::take(&mut self.headers);
        let first = headers.first().map(Vec::as_slice).unwrap_or_default();
        let mut parameters = AudioCodecParameters::new();
        match self.codec {
            Codec::Opus if opus::Head::read(first).is_none() => {
                return Err(AudioError::UnsupportedCodec {
                    container: Container::Ogg,
                    codec: "Opus with more than 2 channels".to_owned(),
                });
            }
            Codec::Opus => parameters.for_codec(CODEC_ID_OPUS).with_extra_data(first.into()),
            Codec::Vorbis(_) => {
                let setup = headers.get(2).map(Vec::as_slice).unwrap_or_default();
                let extra = [first, setup].concat().into_boxed_slice();
                parameters.for_codec(CODEC_ID_VORBIS).with_extra_data(extra)
            }
            Codec::Flac => {
                let info = first.get(FLAC_PREFIX + 8..FLAC_PREFIX + 42);
                let info = info.ok_or_else(|| malformed("its FLAC header is too short"))?;
                parameters.for_codec(CODEC_ID_FLAC).with_extra_data(info.into())
            }
        };
        parameters.with_sample_rate(self.hz);
        Ok(TrackInfo::new(self.serial, parameters, self.hz))
    }

    /// Reads the next page, whose packets are then ready. Returns whether there was one.
    fn read_page(&mut self) -> Result<bool, SymphoniaError> {
        let file = self.file.clone();
        let Some(page) = Page::read(&file, self.at) else {
            return self.resynchronise(&file);
        };
        if !page.is_sound() {
            self.at += ogg_page::MARK.len();
            return Err(SymphoniaError::DecodeError("ogg: page with a wrong checksum"));
        }
        self.at = page.end;
        if page.is_first() && self.headers_left == 0 {
            return Err(SymphoniaError::ResetRequired);
        }
        if page.serial == self.serial {
            self.take(&page);
        }
        Ok(true)
    }

    /// Steps over bytes that are no page.
    fn resynchronise(&mut self, file: &[u8]) -> Result<bool, SymphoniaError> {
        let rest = file.get(self.at + 1..).unwrap_or_default();
        if self.at >= file.len() {
            return Ok(false);
        }
        match rest.windows(4).position(|part| part == ogg_page::MARK) {
            Some(ahead) => {
                self.at += 1 + ahead;
                Err(SymphoniaError::DecodeError("ogg: bytes between two pages"))
            }
            None => {
                self.at = file.len();
                Ok(false)
            }
        }
    }

    /// Takes the packets that end on `page`.
    fn take(&mut self, page: &Page<'_>) {
        let last = self.sequence.replace(page.sequence);
        let jumped = last.is_some_and(|last| page.sequence != last.wrapping_add(1));
        let mut partial = self.partial.take().filter(|_| page.is_continued() && !jumped);
        // The rest of a packet whose beginning is missing.
        let mut orphan = page.is_continued() && partial.is_none();
        let (mut at, mut packets) = (0, Vec::new());
        for &size in page.segments {
            let part = page.body.get(at..at + usize::from(size)).unwrap_or_default();
            at += usize::from(size);
            partial.get_or_insert_default().extend_from_slice(part);
            if size < 255 {
                let packet = partial.take().unwrap_or_default();
                if !std::mem::take(&mut orphan) {
                    packets.push(packet);
                }
            }
        }
        self.partial = partial.filter(|_| !orphan);
        self.complete |= page.is_last();
        if self.headers_left > 0 {
            let count = self.headers_left.min(packets.len());
            self.headers.extend(packets.drain(..count));
            self.headers_left -= count;
            if self.headers_left == 0 {
                self.begin();
            }
        }
        if matches!(self.codec, Codec::Flac) {
            packets.retain(|packet| flac::is_frame(packet));
        }
        if !packets.is_empty() {
            self.queue(packets, page, jumped);
        }
    }

    /// Queues the audio packets of a page, with their times and trims.
    fn queue(&mut self, packets: Vec<Vec<u8>>, page: &Page<'_>, jumped: bool) {
        let durations: Vec<u64> =
            packets.iter().map(|packet| self.codec.duration(packet)).collect();
        let sum = durations.iter().sum::<u64>().cast_signed();
        let stamp = (page.granule >= 0).then_some(page.granule);
        let start = match (self.position, stamp) {
            (Some(position), Some(stamp)) if jumped => {
                let start = stamp.saturating_sub(sum);
                self.leave_gap(start.saturating_sub(position));
                start
            }
            (Some(position), _) => position,
            // The last page may end early; any other is whole, and tells where the stream starts.
            (None, Some(stamp)) if !page.is_last() => stamp.saturating_sub(sum),
            (None, _) => 0,
        };
        if self.position.is_none() && start < 0 && matches!(self.codec, Codec::Vorbis(_)) {
            self.skip = start.unsigned_abs();
        }
        let end = start.saturating_add(sum);
        let mut excess = match stamp {
            Some(stamp) if page.is_last() => end.saturating_sub(stamp).clamp(0, sum).unsigned_abs(),
            _ => 0,
        };
        self.position = Some(stamp.unwrap_or(end));
        let mut trims = vec![0; packets.len()];
        for (trim, duration) in trims.iter_mut().zip(&durations).rev() {
            *trim = excess.min(*duration);
            excess -= *trim;
        }
        for ((data, duration), end) in packets.into_iter().zip(durations).zip(trims) {
            let front = self.skip.min(duration - end);
            self.skip -= front;
            self.push(data, duration - end - front, front, end);
        }
    }

    fn push(&mut self, data: Vec<u8>, kept: u64, front: u64, end: u64) {
        let packet = PacketBuilder::new()
            .track_id(self.serial)
            .pts(self.time)
            .dur(Duration::new(kept))
            .trim_start(Duration::new(front))
            .trim_end(Duration::new(end))
            .data(data)
            .build();
        self.time = self.time.saturating_add(Duration::new(kept));
        self.ready.push_back(packet);
    }

    /// Moves the time on by `samples` that were lost with some pages.
    fn leave_gap(&mut self, samples: i64) {
        if (1..=LONGEST_GAP_S * i64::from(self.hz)).contains(&samples) {
            self.time = self.time.saturating_add(Duration::new(samples.unsigned_abs()));
        }
    }
}

impl PacketReader for OggReader {
    fn next_packet(&mut self) -> Result<Option<Packet>, SymphoniaError> {
        loop {
            if let Some(packet) = self.ready.pop_front() {
                return Ok(Some(packet));
            }
            if !self.read_page()? {
                return if self.complete { Ok(None) } else { Err(end_of_file()) };
            }
        }
    }
}

impl Codec {
    fn duration(&mut self, packet: &[u8]) -> u64 {
        match self {
            Self::Vorbis(Some(blocks)) => blocks.duration(packet),
            Self::Vorbis(None) => 0,
            Self::Opus => opus::duration(packet),
            Self::Flac => flac::frame_samples(packet),
        }
    }
}

/// Returns the first stream of those that start at the beginning which can be decoded.
fn choose(file: &[u8]) -> Result<(u32, Codec), AudioError> {
    let (mut at, mut refused) = (0, None);
    while let Some(page) = Page::read(file, at).filter(Page::is_first) {
        at = page.end;
        let codec = match page.body {
            packet if packet.starts_with(b"\x01vorbis") => {
                return Ok((page.serial, Codec::Vorbis(None)));
            }
            packet if packet.starts_with(b"OpusHead") => return Ok((page.serial, Codec::Opus)),
            // Skeleton only describes the other streams.
            packet if packet.starts_with(b"fishead") => continue,
            packet if packet.starts_with(FLAC) => return Ok((page.serial, Codec::Flac)),
            packet if packet.starts_with(b"Speex") => "Speex",
            packet if packet.starts_with(b"\x80theora") => "Theora video",
            _ => "an unknown codec",
        };
        refused.get_or_insert(codec);
    }
    match refused {
        Some(codec) => {
            Err(AudioError::UnsupportedCodec { container: Container::Ogg, codec: codec.to_owned() })
        }
        None => Err(malformed("it ends inside its first page")),
    }
}

fn malformed(reason: &str) -> AudioError {
    AudioError::Malformed { container: Container::Ogg, reason: reason.to_owned() }
}
