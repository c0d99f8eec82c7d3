//! The fuzz target `container`, and what must hold for any bytes.

use std::time::Duration;

use bailando_core::CancelToken;

use crate::{AudioError, AudioLimits, AudioRange, decode};

/// Decodes bytes as an upload: container, packets, samples. Returns whether they are accepted.
#[must_use]
pub fn container(bytes: &[u8]) -> bool {
    const RATE: u32 = 3_840;
    let limits = AudioLimits {
        max_seconds: 4.0,
        min_seconds: 0.01,
        max_decode_time: Duration::from_secs(5),
        ..AudioLimits::default()
    };
    let (range, bytes) = (AudioRange::default(), bytes.to_vec().into());
    match decode(bytes, range, &[RATE], &limits, &CancelToken::new()) {
        Ok(song) => {
            assert!(song.duration_s <= limits.max_seconds);
            for signal in &song.signals {
                assert!(signal.iter().all(|sample| sample.is_finite()));
                assert!(signal.len() as f64 <= (song.duration_s * f64::from(RATE)).ceil() + 1.0);
            }
            true
        }
        // Builds that check arithmetic find overflows in the decoders that are harmless without.
        Err(AudioError::DecoderPanic { message }) => {
            assert!(message.contains("overflow"), "{message}");
            false
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}
