//! Declarations in the fixed headers of WAV and FLAC files. Values outside the limits are refused
//! before a decoder is made: symphonia refuses some too, but without naming the value.

use crate::{container::Container, error::AudioError, flac, limits::DecodeRequest, sniff::Upload};

/// Refuses sample rates, channels and lengths that the header declares outside the limits.
pub(crate) fn check(upload: &Upload, request: &DecodeRequest<'_>) -> Result<(), AudioError> {
    match upload.container {
        Container::Wav => match wav_format(&upload.bytes) {
            Some((channels, hz)) => request.limits.check_format(hz, channels),
            None => Ok(()),
        },
        Container::Flac => {
            let Some((hz, channels, frames)) = flac::stream_info(&upload.bytes) else {
                return Ok(());
            };
            request.limits.check_format(hz, channels)?;
            request.check_length(frames as f64 / f64::from(hz))
        }
        Container::Mp3 | Container::Ogg | Container::M4a => Ok(()),
    }
}

/// Returns channels and sample rate of a WAV file's `fmt ` chunk.
fn wav_format(bytes: &[u8]) -> Option<(usize, u32)> {
    const MAX_CHUNKS: usize = 64;
    let mut at = 12_usize;
    for _ in 0..MAX_CHUNKS {
        let size = u32_le(bytes, at.checked_add(4)?)?;
        let body = at.checked_add(8)?;
        if bytes.get(at..at + 4)? == b"fmt " {
            let channels = u16::from_le_bytes(*bytes.get(body + 2..)?.first_chunk()?);
            return Some((usize::from(channels), u32_le(bytes, body + 4)?));
        }
        // Chunks start at even positions.
        at = body.checked_add((size as usize).checked_next_multiple_of(2)?)?;
    }
    None
}

fn u32_le(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}
