//! The decoder by itself.

use super::{clock::median, error::Result, report::Stage};
use crate::model::ModelDirectory;

/// Seconds of dance, decoded as one chunk.
const SECONDS: usize = 30;

/// Codes of half a minute to frames.
pub(super) fn measure(directory: &ModelDirectory, repeats: usize, threads: usize) -> Result<Stage> {
    let manifest = directory.manifest();
    let count = (SECONDS * manifest.fps as usize).div_ceil(manifest.frames_per_code.max(1));
    let sizes = [manifest.vocabulary.upper, manifest.vocabulary.lower];
    let pair = |step: usize| sizes.map(|size| (step * 7 % size.max(1)) as u32);
    let codes: Vec<_> = (0..count).map(pair).collect();
    let mut decoder = directory.decoder(threads)?;
    decoder.decode(&codes)?;
    let seconds = median(repeats, || decoder.decode(&codes))?;
    Ok(Stage {
        name: format!("decoder_{SECONDS}_s"),
        threads,
        seconds,
    })
}
