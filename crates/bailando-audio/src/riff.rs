//! RIFF, RF64 and AIFF files. No size is believed: a walk over the chunks finds the description and
//! the samples, the end of the file bounds them, and symphonia gets a header with true sizes.

use std::ops::Range;

use bytes::Bytes;

use crate::{container::Container, error::AudioError, upload::Upload};

/// WAVE format of MPEG layer III.
const MP3: u16 = 0x55;

/// Byte order and names of the two families.
#[derive(Clone, Copy)]
struct Family {
    container: Container,
    description: [u8; 4],
    samples: [u8; 4],
    size: fn([u8; 4]) -> u32,
}

const WAVE: Family = Family {
    container: Container::Wav,
    description: *b"fmt ",
    samples: *b"data",
    size: u32::from_le_bytes,
};
const AIFF: Family = Family {
    container: Container::Aiff,
    description: *b"COMM",
    samples: *b"SSND",
    size: u32::from_be_bytes,
};

/// Returns whether a file starts like WAV, of 32 or 64 bits.
pub(crate) fn is_wav(body: &[u8]) -> bool {
    let form = [b"RIFF", b"RF64", b"BW64"].iter().any(|form| body.starts_with(*form));
    form && body.get(8..12) == Some(b"WAVE")
}

/// Returns whether a file starts like AIFF or AIFF-C.
pub(crate) fn is_aiff(body: &[u8]) -> bool {
    body.starts_with(b"FORM") && matches!(body.get(8..12), Some(b"AIFF" | b"AIFC"))
}

/// Reads a WAV file; one that holds MP3 becomes an upload of that.
pub(crate) fn wav(file: &Bytes) -> Result<Upload, AudioError> {
    let found = Chunks::of(file, WAVE)?;
    let description = file.slice(found.description.clone());
    let tag = u16_le(&description, 0).unwrap_or_default();
    let data = file.slice(found.samples.clone());
    let mut assumed = found.assumed;
    if tag == MP3 {
        assumed.push("the WAV file holds MP3, which is used".to_owned());
        return Ok(Upload { assumed, ..Upload::new(Container::Mp3, data) });
    }
    // Programs write plain PCM with fields after the 16 bytes that it has.
    let kept = if tag == 1 { description.len().min(16) } else { description.len() };
    let mut header = b"RIFF\xff\xff\xff\xffWAVEfmt ".to_vec();
    header.extend(u32::try_from(kept).unwrap_or(u32::MAX).to_le_bytes());
    header.extend_from_slice(&description[..kept]);
    if kept % 2 == 1 {
        header.push(0);
    }
    header.extend(b"data");
    header.extend(u32::try_from(data.len()).unwrap_or(u32::MAX).to_le_bytes());
    let view = vec![Bytes::from(header), data];
    Ok(Upload { view, assumed, ..Upload::new(Container::Wav, file.clone()) })
}

/// Reads an AIFF or AIFF-C file.
pub(crate) fn aiff(file: &Bytes) -> Result<Upload, AudioError> {
    /// Offset and block size in front of the samples.
    const FIELDS: usize = 8;
    let found = Chunks::of(file, AIFF)?;
    let mut description = file[found.description.clone()].to_vec();
    let Range { start, end } = found.samples;
    let offset = u32_be(file, start).unwrap_or_default() as usize;
    let first = start.saturating_add(FIELDS).saturating_add(offset).min(end);
    let data = file.slice(first..end);
    // Channels, frames, bits a sample: the frames follow from the bytes.
    if let (Some(channels), Some(bits)) = (u16_be(&description, 0), u16_be(&description, 6)) {
        let frame = usize::from(channels) * usize::from(bits).div_ceil(8);
        if let Some(frames) = data.len().checked_div(frame) {
            let frames = u32::try_from(frames).unwrap_or(u32::MAX);
            description[2..6].copy_from_slice(&frames.to_be_bytes());
        }
    }
    if description.len() % 2 == 1 {
        description.push(0);
    }
    let size = |bytes: usize| u32::try_from(bytes).unwrap_or(u32::MAX).to_be_bytes();
    let mut header = b"FORM".to_vec();
    header.extend(size(4 + 8 + description.len() + 8 + FIELDS + data.len()));
    header.extend_from_slice(&file[8..12]);
    header.extend(b"COMM");
    header.extend(size(description.len()));
    header.extend(description);
    header.extend(b"SSND");
    header.extend(size(FIELDS + data.len()));
    header.extend([0; FIELDS]);
    let view = vec![Bytes::from(header), data];
    Ok(Upload { view, assumed: found.assumed, ..Upload::new(Container::Aiff, file.clone()) })
}

/// Where description and samples are.
struct Chunks {
    description: Range<usize>,
    samples: Range<usize>,
    assumed: Vec<String>,
}

impl Chunks {
    fn of(file: &[u8], family: Family) -> Result<Self, AudioError> {
        const HEADER: usize = 8;
        let (mut description, mut samples, mut assumed) = (None, None, Vec::new());
        // RF64: the true size of the samples, in a chunk before them.
        let mut large = None;
        let mut at = 12_usize;
        while let Some((kind, size)) = header(file, at, family) {
            let body = at + HEADER;
            let rest = file.len() - body;
            let declared = match large {
                Some(size) if size_is_elsewhere(file, kind) => size,
                _ => u64::from(size),
            };
            let fits = usize::try_from(declared).ok().filter(|&size| size <= rest);
            let length = match fits {
                Some(length) if kind == family.samples => {
                    whole_samples(file, body, length, family, &mut assumed)
                }
                None if kind == family.samples => {
                    let piped = declared == u64::from(u32::MAX);
                    if !piped {
                        assumed.push(format!(
                            "the file is cut short or damaged: its header states {declared} bytes \
                             of audio, and {rest} follow"
                        ));
                    }
                    rest
                }
                fits => fits.unwrap_or(rest),
            };
            let range = body..body + length;
            if kind == *b"ds64" {
                let size = file.get(body + 8..).and_then(|size| size.first_chunk());
                large = size.map(|size| u64::from_le_bytes(*size));
            }
            if kind == family.description && description.is_none() {
                description = Some(range);
            } else if kind == family.samples && samples.is_none() {
                samples = Some(range);
            }
            if description.is_some() && samples.is_some() {
                break;
            }
            at = after(file, body + length, family);
        }
        let missing = |what| AudioError::Malformed {
            container: family.container,
            reason: format!("it ends before its {what}"),
        };
        let description = description.ok_or_else(|| missing("description of the samples"))?;
        let samples = samples.ok_or_else(|| missing("samples"))?;
        note_outer_size(file, &samples, family, &mut assumed);
        Ok(Self { description, samples, assumed })
    }
}

/// Returns name and size of the chunk at `at`.
fn header(file: &[u8], at: usize, family: Family) -> Option<([u8; 4], u32)> {
    let kind = *file.get(at..)?.first_chunk()?;
    let size = *file.get(at.checked_add(4)?..)?.first_chunk()?;
    Some((kind, (family.size)(size)))
}

fn size_is_elsewhere(file: &[u8], kind: [u8; 4]) -> bool {
    kind == *b"data" && !file.starts_with(b"RIFF")
}

/// Returns the bytes of samples of which the header states `length`. A size of 0 that another
/// chunk does not explain is one that was never filled in; so is one after which sound follows.
fn whole_samples(
    file: &[u8],
    body: usize,
    length: usize,
    family: Family,
    assumed: &mut Vec<String>,
) -> usize {
    let end = after(file, body + length, family);
    let rest = file.len() - body;
    let unclaimed = file.len().saturating_sub(end);
    let named = header(file, end, family).is_some_and(|(kind, _)| is_name(kind));
    if named || unclaimed <= length || unclaimed < 1_024 {
        return length;
    }
    assumed.push(format!(
        "the header states {length} bytes of audio, and {rest} follow: all of them are used"
    ));
    rest
}

/// Returns where the next chunk starts: at an even position, unless the file forgot that.
fn after(file: &[u8], end: usize, family: Family) -> usize {
    let padded = end + end % 2;
    let wanted = |at| {
        let kinds = [family.samples, family.description];
        header(file, at, family).is_some_and(|(kind, _)| kinds.contains(&kind))
    };
    if padded != end && wanted(end) && !wanted(padded) { end } else { padded }
}

fn is_name(kind: [u8; 4]) -> bool {
    kind.iter().all(|byte| (b' '..=b'~').contains(byte))
}

/// Notes an outer size that contradicts the samples, which are used all the same.
fn note_outer_size(file: &[u8], samples: &Range<usize>, family: Family, assumed: &mut Vec<String>) {
    let Some((_, outer)) = header(file, 0, family) else { return };
    let end = u64::from(outer) + 8;
    let unknown = outer == u32::MAX;
    if !unknown && end < samples.end as u64 && assumed.is_empty() {
        assumed.push(format!(
            "the header states a file of {end} bytes, the audio alone ends at byte {}: all of it \
             is used",
            samples.end
        ));
    }
}

fn u16_le(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u16_be(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u32_be(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}
