//! The decoder by itself.

use super::{clock::median, report::Stage};
use crate::{CancelToken, Result, model::ModelDirectory};

/// Seconds of dance, decoded as one chunk.
const SECONDS: usize = 30;

/// Codes of half a minute to frames.
pub(super) fn measure(directory: &ModelDirectory, repeats: usize, threads: usize) -> Result<Stage> {
    let manifest = directory.manifest();
    let count = (SECONDS * manifest.fps as usize).div_ceil(manifest.frames_per_code.max(1));
    let codes = |vocabulary: usize| -> Vec<u32> {
        let code = |step: usize| step * 7 % vocabulary.max(1);
        (0..count).map(|step| code(step) as u32).collect()
    };
    let (upper, lower) = (
        codes(manifest.vocabulary.upper),
        codes(manifest.vocabulary.lower),
    );
    let mut decoder = directory.decoder(threads)?;
    let never = CancelToken::new();
    decoder.decode(&upper, &lower, &never)?;
    let seconds = median(repeats, || decoder.decode(&upper, &lower, &never))?;
    Ok(Stage {
        name: format!("decoder_{SECONDS}_s"),
        threads,
        seconds,
    })
}
