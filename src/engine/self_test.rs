//! The start-up test of a model: one that does not fit its manifest, or cannot run, is refused
//! before a user meets it.

use ndarray::{Array2, Axis, Slice};

use super::{
    EngineError,
    chunk_decoder::ChunkDecoder,
    chunks::{CHUNK_CODES, ChunkPlan},
    code_model::{CodeModel, MotionDecoder},
};
use crate::{
    model::{Manifest, ModelError, NextStep, Steps},
    motion::{MotionFrame, ToWorld},
};

/// Largest difference, in metres, between a motion decoded in chunks and at once.
const CHUNK_TOLERANCE: f32 = 1e-4;

/// Runs a whole window with the first and last codes of the vocabulary.
///
/// # Errors
/// [`EngineError::Model`] if the graph fails, gives other vocabularies, or values that are no
/// numbers.
pub(crate) fn test_window(
    model: &mut dyn CodeModel,
    manifest: &Manifest,
) -> Result<(), EngineError> {
    let sizes = [manifest.vocabulary.upper, manifest.vocabulary.lower];
    let context = manifest.gpt.context;
    let (first, last) = ([0; 2], sizes.map(|size| (size - 1) as u32));
    let codes: Vec<_> = [last, first].into_iter().cycle().take(context).collect();
    let music = Array2::zeros((context, manifest.conditioning_columns()));
    let (newest, before) = (codes[context - 1], &codes[..context - 1]);
    model.clear(0);
    if !before.is_empty() {
        let music = music.slice_axis(Axis(0), Slice::from(..context - 1));
        let steps = Steps { codes: before, music };
        model.prefill(0, steps)?;
    }
    let logits = model.step(&[NextStep { codes: newest, music: music.row(context - 1) }])?;
    let found = [logits.upper.ncols(), logits.lower.ncols()];
    if found != sizes {
        let say = |[upper, lower]: [usize; 2]| format!("{upper} upper and {lower} lower");
        return Err(misfit(
            "gpt.onnx: codes per half",
            format!("{}, as the manifest says", say(sizes)),
            say(found),
        ));
    }
    Ok(logits.check_rows(0..1)?)
}

/// Decodes a motion over a chunk's border, in chunks and at once: `receptive_codes` must be enough.
///
/// # Errors
/// [`EngineError::Model`] if the graph fails, the two differ, or a value is no number.
pub(crate) fn test_chunks(
    decoder: &mut dyn MotionDecoder,
    manifest: &Manifest,
) -> Result<(), EngineError> {
    // Both chunks are cut where the other's codes still matter.
    let receptive = manifest.decoder.receptive_codes;
    let size = receptive.min(CHUNK_CODES) + 1;
    let sizes = [manifest.vocabulary.upper, manifest.vocabulary.lower];
    let pair = |step: usize| sizes.map(|size| (size - 1).saturating_sub(step * 7 % size) as u32);
    let codes: Vec<_> = (0..2 * size).map(pair).collect();
    let whole = decoder.decode(&codes)?;
    if !whole.iter().all(|value| value.is_finite()) {
        return Err(misfit("decoder.onnx", "finite numbers".into(), "a value that is none".into()));
    }
    // As it is decoded: in the world's directions, differences would be summed.
    let as_decoded = ToWorld::new(MotionFrame::World, 0.0);
    let mut plan = ChunkPlan::new(codes.len(), Vec::new(), receptive).starting_with(size);
    let mut chunks = ChunkDecoder::new(Vec::new(), as_decoded);
    let mut chunked = Vec::with_capacity(whole.len());
    while let Some(chunk) = plan.next(&codes) {
        chunked.extend(chunks.decode(&chunk, decoder)?);
    }
    let differences = whole.iter().zip(&chunked).map(|(a, b)| (a - b).abs());
    let worst = differences.clone().fold(0.0, f32::max);
    // Each is compared: the maximum would skip NaN.
    if differences.into_iter().all(|difference| difference <= CHUNK_TOLERANCE) {
        return Ok(());
    }
    Err(misfit(
        "decoder.onnx in chunks",
        format!("the same motion as at once with receptive_codes {receptive}"),
        format!("a difference of {worst} m"),
    ))
}

fn misfit(what: &'static str, expected: String, got: String) -> EngineError {
    ModelError::Input { what, expected, got }.into()
}

#[cfg(test)]
mod tests {
    use super::{
        super::fake::{FakeDecoder, FakeModel, directory},
        *,
    };

    #[test]
    fn a_model_that_predicts_no_numbers_is_refused_in_one_line() {
        let (_folder, directory) = directory();
        let manifest = directory.manifest();
        let mut model = FakeModel::new(2);
        test_window(&mut model, manifest).unwrap();
        model.script.lock().no_numbers = Some(0.0);
        let refused = test_window(&mut model, manifest).unwrap_err().to_string();
        assert!(refused.contains("not finite") && !refused.contains('\n'), "{refused}");
    }

    #[test]
    fn a_decoder_of_no_numbers_is_refused_in_one_line() {
        let (_folder, directory) = directory();
        let manifest = directory.manifest();
        let mut decoder = FakeDecoder { columns: manifest.decoded_columns(), last: 0.0 };
        test_chunks(&mut decoder, manifest).unwrap();
        decoder.last = f32::NAN;
        let refused = test_chunks(&mut decoder, manifest).unwrap_err().to_string();
        assert!(refused.contains("finite") && !refused.contains('\n'), "{refused}");
    }
}
