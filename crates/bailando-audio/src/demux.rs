//! Reads an upload packet by packet: the one place that knows symphonia's readers, and which of
//! their errors end a file and which only cost a packet.

use std::{
    collections::VecDeque,
    io::{self, Cursor, ErrorKind, Read, Seek, SeekFrom},
};

use bytes::Bytes;
use symphonia::{
    core::{
        codecs::{
            CodecParameters,
            audio::{
                AudioCodecParameters, AudioDecoder, AudioDecoderOptions, CODEC_ID_NULL_AUDIO,
                well_known::{
                    CODEC_ID_AAC, CODEC_ID_AC3, CODEC_ID_ADPCM_IMA_WAV, CODEC_ID_ADPCM_MS,
                    CODEC_ID_ALAC, CODEC_ID_EAC3, CODEC_ID_OPUS,
                },
            },
        },
        errors::Error as SymphoniaError,
        formats::{FormatOptions, FormatReader, TrackType},
        io::{MediaSource, MediaSourceStream, ReadBytes},
        packet::Packet,
        units::TimeBase,
    },
    default::{
        formats::{FlacReader, IsoMp4Reader, MpaReader, OggReader, WavReader},
        get_codecs,
    },
};

use crate::{
    container::Container,
    error::AudioError,
    flac::{self, Gap},
    limits::{DecodeRequest, SLACK_S},
    sniff::Upload,
};

/// Reader errors in a row after which a file is given up.
const MAX_FAULTS_IN_A_ROW: usize = 32;
/// Bytes of packets that are read ahead of the decoder. Hours of silence fit into less, so that a
/// decode bomb is refused before its first packet is decoded.
const READ_AHEAD: usize = 4 << 20;

/// The bytes of an upload behind symphonia's trait.
struct Source {
    cursor: Cursor<Bytes>,
    seekable: bool,
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.cursor.read(buffer)
    }
}

impl Seek for Source {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.cursor.seek(to)
    }
}

impl MediaSource for Source {
    fn is_seekable(&self) -> bool {
        self.seekable
    }

    fn byte_len(&self) -> Option<u64> {
        Some(self.cursor.get_ref().len() as u64)
    }
}

/// Properties of the audio track as the file declares them; no memory is reserved for them.
#[derive(Clone, Debug)]
pub(crate) struct TrackInfo {
    pub(crate) id: u32,
    pub(crate) parameters: AudioCodecParameters,
    time_base: Option<TimeBase>,
    /// Frames declared, without encoder delay and padding.
    pub(crate) frames: Option<u64>,
    /// Encoder delay in frames (the LAME tag of MP3).
    pub(crate) delay: Option<u32>,
    /// Encoder padding in frames (the LAME tag of MP3).
    pub(crate) padding: Option<u32>,
}

impl TrackInfo {
    /// Returns the seconds that a packet says it lasts.
    pub(crate) fn seconds(&self, packet: &Packet) -> f64 {
        self.time_base.map_or(0.0, |base| {
            packet.dur.get() as f64 * f64::from(base.numer.get()) / f64::from(base.denom.get())
        })
    }
}

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
    reader: Box<dyn FormatReader>,
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
        let reader = open_reader(upload).map_err(|error| refusal(container, &error))?;
        let track = audio_track(reader.as_ref(), container)?;
        let hz = track.parameters.sample_rate.unwrap_or_default();
        let gaps = (container == Container::Flac)
            .then(|| flac::Gaps::new(&upload.bytes, track.frames, hz));
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

    /// Returns a decoder for the track. Only Ogg's trimming is left to it; see [`crate::gapless`].
    pub(crate) fn decoder(&self) -> Result<Box<dyn AudioDecoder>, AudioError> {
        let options = AudioDecoderOptions::default().gapless(self.container == Container::Ogg);
        get_codecs().make_audio_decoder(&self.track.parameters, &options).map_err(|error| {
            match error {
                SymphoniaError::Unsupported(what) => AudioError::UnsupportedCodec {
                    container: self.container,
                    codec: codec_words(&self.track.parameters, what),
                },
                other => refusal(self.container, &other),
            }
        })
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
                    if faults_in_a_row >= MAX_FAULTS_IN_A_ROW {
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

fn open_reader(upload: &Upload) -> Result<Box<dyn FormatReader>, SymphoniaError> {
    let source = Source {
        cursor: Cursor::new(upload.bytes.clone()),
        // An MP3 without a Xing header would be cut at a length guessed from its first bit rate
        // if the reader could look at the end; sequentially it is read as far as it goes.
        seekable: upload.container != Container::Mp3,
    };
    let mut stream = MediaSourceStream::new(Box::new(source), Default::default());
    let options = FormatOptions::default();
    Ok(match upload.container {
        Container::Wav => Box::new(WavReader::try_new(stream, options)?),
        Container::Flac => Box::new(FlacReader::try_new(stream, options)?),
        Container::Mp3 => Box::new(MpaReader::try_new(stream, options)?),
        Container::Ogg => Box::new(OggReader::try_new(stream, options)?),
        Container::M4a => {
            // This reader expects to stand after the size of the first atom, and steps back.
            stream.read_quad_bytes()?;
            Box::new(IsoMp4Reader::try_new(stream, options)?)
        }
    })
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

/// Names a codec: symphonia names only those it was built with.
fn codec_words(parameters: &AudioCodecParameters, reason: &str) -> String {
    let words = match parameters.codec {
        CODEC_ID_AAC => "AAC of another profile than LC with 1 or 2 channels (HE-AAC, for example)",
        CODEC_ID_ALAC => "Apple Lossless (ALAC)",
        CODEC_ID_OPUS => "Opus",
        CODEC_ID_AC3 | CODEC_ID_EAC3 => "Dolby Digital (AC-3)",
        CODEC_ID_ADPCM_MS | CODEC_ID_ADPCM_IMA_WAV => "ADPCM (only PCM samples are read)",
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

/// Translates an error of reading the headers.
fn refusal(container: Container, error: &SymphoniaError) -> AudioError {
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
