//! Reads an upload packet by packet: the one place that knows symphonia's readers, and which of
//! their errors end a file and which only cost a packet.

use std::{collections::VecDeque, io::ErrorKind};

use symphonia::{
    core::{
        codecs::CodecParameters,
        errors::Error as SymphoniaError,
        formats::{FormatOptions, FormatReader, Track, TrackType},
        io::{MediaSourceStream, ReadBytes},
        packet::Packet,
    },
    default::formats::{AiffReader, FlacReader, IsoMp4Reader, WavReader},
};

use crate::{
    codec::Decoder,
    container::Container,
    error::AudioError,
    flac::{self, Gap},
    limits::{DecodeRequest, SLACK_S},
    mp3::Mp3Reader,
    mp4_tables,
    ogg::OggReader,
    packets::{PacketReader, TrackInfo, refusal},
    rope::Rope,
    upload::Upload,
    webm::WebmReader,
};

/// Reader errors in a row after which a file is given up.
const MAX_FAULTS_IN_A_ROW: usize = 32;
/// Reader errors in all after which a file is given up: each may have cost some reading.
const MAX_FAULTS: usize = 1_024;
/// Bytes of packets that are read ahead of the decoder. Hours of silence fit into less, so that a
/// decode bomb is refused before its first packet is decoded.
const READ_AHEAD: usize = 4 << 20;

/// Faults of the container up to some packet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct StreamState {
    /// The bytes ended inside something.
    pub(crate) cut_off: bool,
    /// Another stream follows the first one (chained Ogg).
    pub(crate) chained: bool,
    /// Faults that were stepped over, or ended the file.
    pub(crate) faults: usize,
}

/// The packets of an upload's audio track.
pub(crate) struct Demuxer {
    reader: Box<dyn PacketReader>,
    pub(crate) container: Container,
    pub(crate) track: TrackInfo,
    /// State of the stream at the packet that was taken last.
    pub(crate) state: StreamState,
    /// Packets read ahead, with the state of the stream at each.
    ahead: VecDeque<(Packet, StreamState)>,
    ahead_bytes: usize,
    /// State of the stream where the reader is.
    reader_state: StreamState,
    ended: bool,
    /// Seconds that all packets read so far say they last.
    seconds: f64,
    /// Bytes of packets that the file may still yield: a file's packets cannot be larger than the
    /// file, unless its tables point at the same bytes again and again.
    allowance: usize,
    gaps: Option<flac::Gaps>,
}

impl Demuxer {
    /// Reads the headers of `upload`.
    pub(crate) fn open(upload: &Upload) -> Result<Self, AudioError> {
        let container = upload.container;
        let (reader, track): (Box<dyn PacketReader>, TrackInfo) = match container {
            Container::Ogg => boxed(OggReader::open(&upload.bytes)?),
            Container::Webm => boxed(WebmReader::open(&upload.bytes)?),
            Container::Mp3 => boxed(Mp3Reader::open(&upload.bytes)?),
            Container::M4a => boxed(open_movie(upload)?),
            Container::Wav | Container::Aiff | Container::Flac => {
                let reader = open_reader(container, Rope::new(upload.view.clone(), true))
                    .map_err(|error| refusal(container, &error))?;
                let track = audio_track(reader.as_ref(), container)?;
                boxed((reader, track))
            }
        };
        let hz = track.parameters.sample_rate.unwrap_or_default();
        let gaps = match container {
            Container::Flac => Some(flac::Gaps::new(&upload.bytes, track.frames, hz)),
            Container::Ogg => Some(flac::Gaps::from_zero(hz)),
            _ => None,
        };
        Ok(Self {
            reader,
            container,
            track,
            state: StreamState::default(),
            ahead: VecDeque::new(),
            ahead_bytes: 0,
            reader_state: StreamState::default(),
            ended: false,
            seconds: 0.0,
            allowance: upload.bytes.len().saturating_mul(2).saturating_add(65_536),
            gaps,
        })
    }

    /// Returns a decoder for the track.
    pub(crate) fn decoder(&self) -> Result<Decoder, AudioError> {
        Decoder::new(self.container, &self.track.parameters)
    }

    /// Returns what is missing between the packet before `packet` and itself.
    pub(crate) fn gap_before(&mut self, packet: &Packet) -> Option<Gap> {
        self.gaps.as_mut()?.before(packet)
    }

    /// Returns the next packet of the track; `None` at the end, however the file ended.
    ///
    /// # Errors
    /// [`AudioError::TooLong`] as soon as the packets read ahead say so; [`AudioError::Malformed`]
    /// for tables without end; the deadline's.
    pub(crate) fn next(
        &mut self,
        request: &DecodeRequest<'_>,
    ) -> Result<Option<Packet>, AudioError> {
        request.deadline.check()?;
        self.read_ahead(request)?;
        let Some((packet, state)) = self.ahead.pop_front() else {
            self.state = self.reader_state;
            return Ok(None);
        };
        self.ahead_bytes -= cost(&packet);
        self.state = state;
        Ok(Some(packet))
    }

    /// Fills the queue up to [`READ_AHEAD`] or the end of the range. A file of hours of silence is
    /// a few hundred kilobytes of packets, but gigabytes of samples. The packets' own durations are
    /// not believed further than that: the decoded samples are counted as well.
    fn read_ahead(&mut self, request: &DecodeRequest<'_>) -> Result<(), AudioError> {
        while !self.ended
            && (self.ahead.is_empty()
                || self.ahead_bytes < READ_AHEAD && self.seconds - SLACK_S <= request.range.end_s())
        {
            let Some(packet) = self.read(request)? else {
                self.ended = true;
                return Ok(());
            };
            self.seconds += self.track.seconds(&packet);
            request.check_length(self.seconds - SLACK_S)?;
            self.ahead_bytes += cost(&packet);
            self.ahead.push_back((packet, self.reader_state));
        }
        Ok(())
    }

    fn read(&mut self, request: &DecodeRequest<'_>) -> Result<Option<Packet>, AudioError> {
        let mut faults_in_a_row = 0;
        let state = &mut self.reader_state;
        loop {
            request.deadline.check()?;
            match self.reader.next_packet() {
                Ok(Some(packet)) => {
                    faults_in_a_row = 0;
                    // A packet of no bytes counts as one, so that tables of them end as well.
                    let bytes = packet.data.len().max(1);
                    self.allowance =
                        self.allowance.checked_sub(bytes).ok_or_else(|| AudioError::Malformed {
                            container: self.container,
                            reason: "its tables list more audio than the file has bytes".to_owned(),
                        })?;
                    if packet.track_id == self.track.id {
                        return Ok(Some(packet));
                    }
                }
                Ok(None) => return Ok(None),
                Err(SymphoniaError::IoError(error)) if error.kind() == ErrorKind::UnexpectedEof => {
                    state.cut_off = true;
                    return Ok(None);
                }
                Err(SymphoniaError::ResetRequired) => {
                    state.chained = true;
                    return Ok(None);
                }
                Err(_) => {
                    state.faults += 1;
                    faults_in_a_row += 1;
                    if faults_in_a_row >= MAX_FAULTS_IN_A_ROW || state.faults >= MAX_FAULTS {
                        return Ok(None);
                    }
                }
            }
        }
    }
}

/// Bytes that a packet occupies in the queue.
fn cost(packet: &Packet) -> usize {
    size_of::<Packet>() + packet.data.len()
}

fn boxed<R: PacketReader + 'static>(
    (reader, track): (R, TrackInfo),
) -> (Box<dyn PacketReader>, TrackInfo) {
    (Box::new(reader), track)
}

fn open_reader(
    container: Container,
    source: Rope,
) -> Result<Box<dyn FormatReader>, SymphoniaError> {
    let mut stream = MediaSourceStream::new(Box::new(source), Default::default());
    let options = FormatOptions::default();
    Ok(match container {
        Container::Aiff => Box::new(AiffReader::try_new(stream, options)?),
        Container::Flac => Box::new(FlacReader::try_new(stream, options)?),
        Container::M4a => {
            // This reader expects to stand after the size of the first atom, and steps back.
            stream.read_quad_bytes()?;
            Box::new(IsoMp4Reader::try_new(stream, options)?)
        }
        _ => Box::new(WavReader::try_new(stream, options)?),
    })
}

/// Opens a movie with all tracks but the first one hidden that can be decoded. A track that another
/// codec keeps from being used may be the file's first.
fn open_movie(upload: &Upload) -> Result<(Box<dyn FormatReader>, TrackInfo), AudioError> {
    let container = upload.container;
    let open = |chosen| {
        let view = mp4_tables::view(&upload.bytes, chosen)?;
        open_reader(container, Rope::new(view, true)).map_err(|error| refusal(container, &error))
    };
    let reader = open(None)?;
    let decodable = |track: &&Track| match &track.codec_params {
        Some(CodecParameters::Audio(parameters)) => Decoder::new(container, parameters).is_ok(),
        _ => false,
    };
    let sound = reader.tracks().iter().filter(|track| is_audio(track));
    let chosen = sound.clone().find(decodable).map(|track| track.id);
    let reader = match chosen.filter(|_| reader.tracks().len() > 1) {
        Some(_) => open(chosen)?,
        None => reader,
    };
    let track = audio_track(reader.as_ref(), container)?;
    Ok((reader, track))
}

fn is_audio(track: &Track) -> bool {
    matches!(track.codec_params, Some(CodecParameters::Audio(_)))
}

fn audio_track(reader: &dyn FormatReader, container: Container) -> Result<TrackInfo, AudioError> {
    let track =
        reader.default_track(TrackType::Audio).ok_or_else(|| AudioError::UnsupportedCodec {
            container,
            codec: "no audio track that can be read".to_owned(),
        })?;
    let Some(CodecParameters::Audio(parameters)) = &track.codec_params else {
        return Err(AudioError::Malformed {
            container,
            reason: "its audio track has no parameters".to_owned(),
        });
    };
    Ok(TrackInfo {
        id: track.id,
        parameters: parameters.clone(),
        time_base: track.time_base,
        frames: track.num_frames,
        delay: track.delay,
        padding: track.padding,
    })
}
