//! What the fuzz targets and the tests of their corpora do with bytes from a stranger, and what must
//! hold whatever the bytes are. Each function says whether it could use them. Not a part of the library.

use std::time::Duration;

use crate::{
    CancelToken,
    audio::{self, AudioError, AudioLimits, AudioRange},
    engine::{DEFAULT_BATCH, GenerationOptions},
    formats::OutputFormat,
    model::{Manifest, graph_is_accepted},
    server::options::RequestOptions,
};

/// Longest answer to a wrong option: what was sent is never repeated at length.
const LONGEST_ANSWER: usize = 1024;

/// Bytes as an upload: container, packets, samples.
#[must_use]
pub fn container(bytes: &[u8]) -> bool {
    const RATE: u32 = 3_840;
    let limits = AudioLimits {
        max_seconds: 4.0,
        min_seconds: 0.01,
        max_decode_time: Duration::from_secs(5),
        ..AudioLimits::default()
    };
    let range = AudioRange::default();
    let bytes = bytes.to_vec().into();
    match audio::decode(bytes, range, &[RATE], &limits, &CancelToken::new()) {
        Ok(song) => {
            assert!(song.duration_s <= limits.max_seconds);
            for signal in &song.signals {
                assert!(signal.iter().all(|sample| sample.is_finite()));
                assert!(signal.len() as f64 <= (song.duration_s * f64::from(RATE)).ceil() + 1.0);
            }
            return true;
        }
        // Builds that check arithmetic find overflows in the decoders that do no harm without.
        Err(AudioError::DecoderPanic { message }) => {
            assert!(message.contains("overflow"), "{message}");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    false
}

/// Bytes as the query of a request to the model of `manifest`.
#[must_use]
pub fn options(bytes: &[u8], manifest: &Manifest) -> bool {
    let Ok(uri) = format!("/generate?{}", String::from_utf8_lossy(bytes)).parse() else {
        return false;
    };
    let options = match RequestOptions::from_query(&uri) {
        Ok(options) => options,
        Err(error) => {
            let answer = error.to_string();
            assert!(answer.len() <= LONGEST_ANSWER, "{answer}");
            return false;
        }
    };
    let generation = options.generation(OutputFormat::Json);
    if let Some(tail) = &generation.continue_from {
        assert_eq!(tail.to_text().parse().ok().as_ref(), Some(tail));
    }
    let same = RequestOptions::default();
    assert!(options.written_as(&same).is_ok_and(|kept| kept == options));
    match generation.check(manifest, DEFAULT_BATCH.get()) {
        Ok(()) => true,
        Err(error) => {
            assert!(error.to_string().len() <= LONGEST_ANSWER, "{error}");
            false
        }
    }
}

/// Bytes as a manifest.
#[must_use]
pub fn manifest(bytes: &[u8]) -> bool {
    let Ok(manifest) = serde_json::from_slice::<Manifest>(bytes) else {
        return false;
    };
    if let Err(problem) = manifest.validate() {
        assert!(!problem.is_empty());
        return false;
    }
    assert!(manifest.decoded_columns() >= manifest.motion_columns());
    assert!(!manifest.skeleton.foot_joints().is_empty());
    assert!(
        manifest
            .files
            .keys()
            .all(|name| !name.contains(['/', '\\']))
    );
    let defaults = GenerationOptions::default();
    assert!(defaults.check(&manifest, DEFAULT_BATCH.get()).is_ok());
    let text = serde_json::to_vec(&manifest).unwrap_or_default();
    let again = serde_json::from_slice::<Manifest>(&text);
    assert!(again.is_ok_and(|again| again.validate().is_ok()));
    true
}

/// Bytes as a graph of a model directory, as far as they are looked at before ONNX Runtime reads
/// them.
#[must_use]
pub fn graph(bytes: &[u8]) -> bool {
    graph_is_accepted(bytes)
}
