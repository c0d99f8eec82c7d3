//! The loaded model, which proves at start that it fits its manifest.

use std::{sync::Arc, time::Duration};

use crossbeam_channel::bounded;
use ndarray::Array2;

use super::{
    EngineError, GenerationOptions,
    batch::Batch,
    chunk_decoder::ChunkDecoder,
    chunks::{CHUNK_CODES, ChunkPlan},
    frames::SharedDecoder,
    observer::Observer,
    reply::Reply,
    sampler::Sampling,
    window::Window,
    worker::Job,
};
use crate::{
    CancelToken, Error, Result,
    formats::Codes,
    model::{Gpt, ModelDirectory, ModelError, Steps, Vocabulary, WindowKind},
    motion::{MotionFrame, ToWorld},
};

/// Bytes of a GPT below which its steps have one thread.
const ALONE_BELOW: u64 = 8 << 20;
/// Largest difference, in metres, between a piece decoded in chunks and at once.
const CHUNK_TOLERANCE: f32 = 1e-4;

/// The ONNX sessions of one model directory.
pub(crate) struct Sessions {
    pub(super) gpt: Gpt,
    pub(super) decoder: SharedDecoder,
    pub(super) directory: ModelDirectory,
}

impl Sessions {
    /// Loads every graph and tries it: one that does not fit the manifest, or cannot run, is found
    /// at start and not by a user.
    pub(crate) fn load(directory: ModelDirectory, threads: usize) -> Result<Self> {
        let mut sessions = Self {
            gpt: directory.gpt(step_threads(&directory, threads))?,
            decoder: SharedDecoder::new(directory.decoder(threads)?),
            directory,
        };
        sessions.directory.encoder(threads)?;
        sessions.try_whole_window()?;
        sessions.try_chunks()?;
        Ok(sessions)
    }

    /// A whole window with the first and last codes of the vocabulary.
    fn try_whole_window(&mut self) -> Result<()> {
        let manifest = self.directory.manifest();
        let Vocabulary { upper, lower } = manifest.vocabulary;
        let context = manifest.gpt.context;
        let codes = |vocabulary: usize| -> Vec<u32> {
            let code = |step| if step % 2 == 0 { vocabulary - 1 } else { 0 };
            (0..context).map(|step| code(step) as u32).collect()
        };
        let music = Array2::zeros((context, manifest.features.columns));
        let steps = Steps {
            upper: &codes(upper),
            lower: &codes(lower),
            music: music.view(),
        };
        let mut cache = self.gpt.empty_cache()?;
        let logits = self.gpt.run(steps, &mut cache, &CancelToken::new())?;
        let found = (logits.upper.ncols(), logits.lower.ncols());
        if found != (upper, lower) {
            return Err(misfit(
                "gpt.onnx: codes per half",
                format!("{upper} upper and {lower} lower, as the manifest says"),
                format!("{} upper and {} lower", found.0, found.1),
            ));
        }
        Ok(())
    }

    /// A piece over a chunk's border, in chunks and at once: `receptive_codes` must be enough.
    fn try_chunks(&self) -> Result<()> {
        let manifest = self.directory.manifest();
        // Both chunks are cut where the other's codes still matter.
        let receptive = manifest.decoder.receptive_codes;
        let size = receptive.min(CHUNK_CODES) + 1;
        let count = 2 * size;
        let codes = |vocabulary: usize| -> Vec<u32> {
            let code = |step| (vocabulary - 1).saturating_sub(step * 7 % vocabulary);
            (0..count).map(|step| code(step) as u32).collect()
        };
        let codes = Codes {
            upper: codes(manifest.vocabulary.upper),
            lower: codes(manifest.vocabulary.lower),
        };
        let cancel = CancelToken::new();
        let mut decoder = self.decoder.lock();
        let whole = decoder.decode(&codes.upper, &codes.lower, &cancel)?;
        // As it is decoded: in the world's directions, differences would be summed.
        let as_decoded = ToWorld::new(MotionFrame::World, 0.0);
        let mut plan = ChunkPlan::new(count, Codes::default(), receptive).starting_with(size);
        let mut chunks = ChunkDecoder::new(Codes::default(), as_decoded);
        let halves = [&codes.upper[..], &codes.lower[..]];
        let mut chunked = Vec::with_capacity(whole.len());
        while let Some(chunk) = plan.next(halves) {
            chunked.extend(chunks.decode(&chunk, &mut decoder, &cancel)?);
        }
        let apart = |(a, b): (&f32, &f32)| (a - b).abs();
        let worst = whole.iter().zip(&chunked).map(apart).fold(0.0, f32::max);
        if worst > CHUNK_TOLERANCE {
            return Err(misfit(
                "decoder.onnx in chunks",
                format!("the same motion as at once with receptive_codes {receptive}"),
                format!("a difference of {worst} m"),
            ));
        }
        Ok(())
    }

    /// A batch of at most `rows` dances, after two codes by the path that requests take; it also warms the
    /// step up.
    pub(crate) fn tried(self, rows: usize, observer: Arc<dyn Observer>) -> Result<Batch> {
        let columns = self.directory.manifest().features.columns;
        let job = Job {
            music: Array2::zeros((3, columns)),
            sampling: Sampling {
                temperature: 1.0,
                top_k: None,
            },
            // Two branches, if that is the default.
            guidance: self.directory.manifest().sampling.guidance,
            // As many as there is room for.
            candidates: GenerationOptions::default().candidates(self.directory.manifest(), rows),
            redo: false,
            beats: vec![4, 12, 20],
            seed: 0,
            start: [None, None],
            window: Window::new(WindowKind::Hop, 1, 2),
            history: Codes::default(),
            facing: 0.0,
            progress: Arc::new(()),
            listener: None,
            cancel: CancelToken::new(),
        };
        let (reply, outcome) = bounded(1);
        let mut batch = Batch::new(self, rows, observer)?;
        batch.join(job, Reply::new(reply), Duration::ZERO);
        while !batch.is_idle() {
            batch.round();
        }
        outcome.recv().map_err(|_| EngineError::Stopped)??;
        Ok(batch)
    }
}

/// Threads of a step: a small one is over before several threads agree (`bailando bench`).
fn step_threads(directory: &ModelDirectory, threads: usize) -> usize {
    let file = directory.manifest().files.get("gpt.onnx");
    match file.is_some_and(|file| file.bytes < ALONE_BELOW) {
        true => 1,
        false => threads,
    }
}

fn misfit(what: &'static str, expected: String, got: String) -> Error {
    ModelError::Input {
        what,
        expected,
        got,
    }
    .into()
}
