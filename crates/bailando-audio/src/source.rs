//! Opens an upload as a stream of packets: the one place that knows symphonia's readers, and which
//! of their errors end a file and which only cost a packet.

use std::io::{self, Cursor, ErrorKind, Read, Seek, SeekFrom};

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
        units::{Duration, TimeBase, Timestamp},
    },
    default::{
        formats::{FlacReader, IsoMp4Reader, MpaReader, OggReader, WavReader},
        get_codecs,
    },
};

use super::{
    AudioError,
    limits::Watch,
    sniff::{Container, Upload},
};

/// Reader errors in a row after which a file is given up.
const MAX_FAULTS_IN_A_ROW: usize = 32;

/// Bytes of an upload as symphonia wants them.
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

/// What a file says about its audio track. None of it is trusted for memory.
#[derive(Clone, Debug)]
pub(super) struct TrackInfo {
    pub(super) id: u32,
    pub(super) parameters: AudioCodecParameters,
    pub(super) time_base: Option<TimeBase>,
    /// Frames declared, without encoder delay and padding.
    pub(super) frames: Option<u64>,
    /// Encoder delay and padding in frames (MP3's LAME tag).
    pub(super) delay: Option<u32>,
    pub(super) padding: Option<u32>,
}

impl TrackInfo {
    /// Seconds that a packet says it lasts.
    pub(super) fn seconds(&self, packet: &Packet) -> f64 {
        self.in_seconds(packet.dur)
    }

    fn in_seconds(&self, duration: Duration) -> f64 {
        self.time_base.map_or(0.0, |base| {
            duration.get() as f64 * f64::from(base.numer.get()) / f64::from(base.denom.get())
        })
    }
}

/// How a packet stream ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Ending {
    /// The bytes ended inside something.
    pub(super) cut_off: bool,
    /// Another stream follows behind the first one (chained Ogg).
    pub(super) chained: bool,
    /// Faults of the container that were stepped over, or ended the file.
    pub(super) faults: usize,
}

/// The packets of an upload's audio track.
pub(super) struct Packets {
    reader: Box<dyn FormatReader>,
    pub(super) container: Container,
    pub(super) track: TrackInfo,
    pub(super) ending: Ending,
    /// Where the next packet of a FLAC file should start, in its time base.
    expected: Option<Timestamp>,
    /// Payload bytes that the file may still yield: a file's packets cannot be larger than the
    /// file, unless its tables point at the same bytes again and again.
    allowance: usize,
}

impl Packets {
    /// Reads the headers of `upload`.
    pub(super) fn open(upload: &Upload) -> Result<Self, AudioError> {
        let container = upload.container;
        let reader = open_reader(upload).map_err(|error| refusal(container, &error))?;
        let track = audio_track(reader.as_ref(), container)?;
        Ok(Self {
            reader,
            container,
            track,
            ending: Ending::default(),
            expected: None,
            allowance: upload.bytes.len().saturating_mul(2).saturating_add(65_536),
        })
    }

    /// A decoder for the track. Only Ogg's trimming is left to it; see [`super::gapless`].
    pub(super) fn decoder(&self) -> Result<Box<dyn AudioDecoder>, AudioError> {
        let options = AudioDecoderOptions::default().gapless(self.container == Container::Ogg);
        get_codecs()
            .make_audio_decoder(&self.track.parameters, &options)
            .map_err(|error| match error {
                SymphoniaError::Unsupported(what) => AudioError::UnsupportedCodec {
                    container: self.container,
                    codec: codec_words(&self.track.parameters, what),
                },
                other => refusal(self.container, &other),
            })
    }

    /// Seconds missing between the packet before `packet` and itself. The FLAC reader drops frames
    /// with a wrong checksum without a word, but every frame carries its position.
    pub(super) fn seconds_lost_before(&mut self, packet: &Packet) -> f64 {
        if self.container != Container::Flac {
            return 0.0;
        }
        let expected = self.expected.replace(packet.pts.saturating_add(packet.dur));
        expected
            .and_then(|expected| packet.pts.duration_from(expected))
            .map_or(0.0, |gap| self.track.in_seconds(gap))
    }

    /// The next packet of the track; `None` at the end, however the file ended.
    pub(super) fn next(&mut self, watch: &Watch<'_>) -> Result<Option<Packet>, AudioError> {
        let mut faults_in_a_row = 0;
        loop {
            watch.check()?;
            match self.reader.next_packet() {
                Ok(Some(packet)) => {
                    faults_in_a_row = 0;
                    // A packet of no bytes counts as one, so that tables of them end as well.
                    let cost = packet.data.len().max(1);
                    self.allowance =
                        self.allowance
                            .checked_sub(cost)
                            .ok_or_else(|| AudioError::Malformed {
                                container: self.container,
                                reason: "its tables list more audio than the file has bytes"
                                    .to_owned(),
                            })?;
                    if packet.track_id == self.track.id {
                        return Ok(Some(packet));
                    }
                }
                Ok(None) => return Ok(None),
                Err(SymphoniaError::IoError(error)) if error.kind() == ErrorKind::UnexpectedEof => {
                    self.ending.cut_off = true;
                    return Ok(None);
                }
                Err(SymphoniaError::ResetRequired) => {
                    self.ending.chained = true;
                    return Ok(None);
                }
                Err(_) => {
                    self.ending.faults += 1;
                    faults_in_a_row += 1;
                    if faults_in_a_row >= MAX_FAULTS_IN_A_ROW {
                        return Ok(None);
                    }
                }
            }
        }
    }
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
            // This reader expects to be behind the size of the first atom, and steps back over it.
            stream.read_quad_bytes()?;
            Box::new(IsoMp4Reader::try_new(stream, options)?)
        }
    })
}

fn audio_track(reader: &dyn FormatReader, container: Container) -> Result<TrackInfo, AudioError> {
    let track =
        reader
            .default_track(TrackType::Audio)
            .ok_or_else(|| AudioError::UnsupportedCodec {
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

/// The codec in words: symphonia names only what it was built with.
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

/// What an error while reading the headers means.
pub(super) fn refusal(container: Container, error: &SymphoniaError) -> AudioError {
    match error {
        SymphoniaError::IoError(error) if error.kind() == ErrorKind::UnexpectedEof => {
            AudioError::Malformed {
                container,
                reason: "it ends inside its header".to_owned(),
            }
        }
        SymphoniaError::Unsupported(what) if what.contains("missing") => AudioError::Malformed {
            container,
            reason: (*what).to_owned(),
        },
        SymphoniaError::Unsupported(what) => AudioError::UnsupportedCodec {
            container,
            codec: format!("something unsupported ({what})"),
        },
        other => AudioError::Malformed {
            container,
            reason: other.to_string(),
        },
    }
}

/// Whether an Ogg file ends with a whole page that is marked as the last one: nothing else in it
/// tells that it was cut.
pub(super) fn ogg_is_whole(bytes: &[u8]) -> bool {
    const HEADER: usize = 27;
    const LARGEST_PAGE: usize = HEADER + 255 + 255 * 255;
    const LAST_PAGE: u8 = 4;
    let tail = &bytes[bytes.len().saturating_sub(LARGEST_PAGE)..];
    let Some(start) = tail.windows(4).rposition(|part| part == b"OggS") else {
        return false;
    };
    let page = &tail[start..];
    let Some((header, rest)) = page.split_at_checked(HEADER) else {
        return false;
    };
    let segments = usize::from(header[HEADER - 1]);
    let length = rest.get(..segments).map(|sizes| {
        let body: usize = sizes.iter().map(|&size| usize::from(size)).sum();
        HEADER + segments + body
    });
    header[5] & LAST_PAGE != 0 && length.is_some_and(|length| page.len() >= length)
}
