//! Songs of the data as samples.

use std::{path::Path, time::Duration};

use bailando::{
    CancelToken,
    audio::{AudioLimits, AudioRange, DecodedAudio, decode},
};

use super::DataError;

/// Decodes a song of the data: longer than any upload may be.
pub(super) fn decoded(
    path: &Path,
    bytes: Vec<u8>,
    rates: &[u32],
) -> Result<DecodedAudio, DataError> {
    let limits = AudioLimits {
        max_seconds: 3_600.0,
        min_seconds: 0.0,
        min_sample_rate: 3_840,
        max_decode_time: Duration::from_secs(300),
        ..AudioLimits::default()
    };
    let (range, cancel) = (AudioRange::default(), CancelToken::new());
    decode(bytes.into(), range, rates, &limits, &cancel)
        .map_err(|source| DataError::Audio { path: path.to_owned(), source })
}
