//! The fuzz targets `options` and `manifest`, and what must hold for any bytes. Each function
//! returns whether it accepts the bytes. Not a part of the library.

use crate::{
    engine::{DEFAULT_BATCH, GenerationOptions},
    formats::OutputFormat,
    model::Manifest,
    server::options::RequestOptions,
};

/// Longest answer to a wrong option: it never repeats a long value.
const LONGEST_ANSWER: usize = 1024;

/// Reads bytes as the query of a request to the model of `manifest`.
#[must_use]
pub fn options(bytes: &[u8], manifest: &Manifest) -> bool {
    let Ok(uri) = format!("/generate?{}", String::from_utf8_lossy(bytes)).parse() else {
        return false;
    };
    let options = match RequestOptions::from_query(&uri) {
        Ok(options) => options,
        Err(error) => return refused(&error),
    };
    let generation = options.generation(OutputFormat::Json);
    if let Some(tail) = &generation.continue_from {
        assert_eq!(tail.to_text().parse().ok().as_ref(), Some(tail));
    }
    let same = RequestOptions::default();
    assert!(options.written_as(&same).is_ok_and(|kept| kept == options));
    match generation.check(manifest, DEFAULT_BATCH.get()) {
        Ok(()) => true,
        Err(error) => refused(&error),
    }
}

fn refused(error: &dyn std::fmt::Display) -> bool {
    let answer = error.to_string();
    assert!(answer.len() <= LONGEST_ANSWER, "{answer}");
    false
}

/// Reads bytes as a manifest.
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
    let mut files = manifest.files.keys();
    assert!(files.all(|name| !name.contains(['/', '\\'])));
    let defaults = GenerationOptions::default();
    assert!(defaults.check(&manifest, DEFAULT_BATCH.get()).is_ok());
    let text = serde_json::to_vec(&manifest).unwrap_or_default();
    let again = serde_json::from_slice::<Manifest>(&text);
    assert!(again.is_ok_and(|again| again.validate().is_ok()));
    true
}
