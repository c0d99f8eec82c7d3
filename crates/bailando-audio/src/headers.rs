//! Declarations in the fixed headers of WAV and FLAC files. Values outside the limits are refused
//! before a decoder is made: symphonia refuses some too, but without naming the value.

use crate::{container::Container, error::AudioError, flac, limits::DecodeRequest, upload::Upload};

/// Refuses sample rates, channels and lengths that the header declares outside the limits.
pub(crate) fn check(upload: &Upload, request: &DecodeRequest<'_>) -> Result<(), AudioError> {
    match upload.container {
        Container::Wav => match upload.view.first().and_then(|header| wav_format(header)) {
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
        _ => Ok(()),
    }
}

/// Returns channels and sample rate from the header that [`crate::riff`] wrote.
fn wav_format(header: &[u8]) -> Option<(usize, u32)> {
    const FORMAT: usize = 20;
    let channels = u16::from_le_bytes(*header.get(FORMAT + 2..)?.first_chunk()?);
    let hz = u32::from_le_bytes(*header.get(FORMAT + 4..)?.first_chunk()?);
    Some((usize::from(channels), hz))
}
