//! The loaded model: proves at start that it fits its manifest, and works on one job at a time.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use ndarray::Array2;

use super::{
    error::of_model,
    generator::{CHUNK_CODES, Request, decode_codes, generate_codes},
    guidance::Guide,
    progress::Stage,
    sampler::{Sampler, Sampling},
    search::Search,
    window::Window,
    worker::{Job, Outcome},
};
use crate::{
    CancelToken, Error, Result,
    format::Codes,
    model::{Decoder, Gpt, Manifest, ModelDirectory, ModelError, Steps, Vocabulary, WindowKind},
};

/// Largest difference, in metres, between a piece decoded in chunks and at once.
const CHUNK_TOLERANCE: f32 = 1e-4;

/// The ONNX sessions of one model directory.
pub(crate) struct Sessions {
    gpt: Gpt,
    decoder: Decoder,
    directory: ModelDirectory,
}

impl Sessions {
    /// Loads every graph and tries it: one that does not fit the manifest, or cannot run, is found
    /// at start and not by a user.
    pub(crate) fn load(directory: ModelDirectory, threads: usize) -> Result<Self> {
        let mut sessions = Self {
            gpt: directory.gpt(threads)?,
            decoder: directory.decoder(threads)?,
            directory,
        };
        sessions.directory.encoder(threads)?;
        sessions.try_whole_window()?;
        sessions.try_chunks()?;
        sessions.try_sampling()?;
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
    fn try_chunks(&mut self) -> Result<()> {
        let manifest = self.directory.manifest();
        let count = CHUNK_CODES + manifest.decoder.receptive_codes.min(CHUNK_CODES) + 1;
        let codes = |vocabulary: usize| -> Vec<u32> {
            let code = |step| (vocabulary - 1).saturating_sub(step * 7 % vocabulary);
            (0..count).map(|step| code(step) as u32).collect()
        };
        let codes = Codes {
            upper: codes(manifest.vocabulary.upper),
            lower: codes(manifest.vocabulary.lower),
        };
        let cancel = CancelToken::new();
        let whole = self.decoder.decode(&codes.upper, &codes.lower, &cancel)?;
        let chunked = decode_codes(&mut self.decoder, &codes, manifest, &cancel)?;
        let apart = |(a, b): (&f32, &f32)| (a - b).abs();
        let worst = whole.iter().zip(&chunked).map(apart).fold(0.0, f32::max);
        if worst > CHUNK_TOLERANCE {
            return Err(misfit(
                "decoder.onnx in chunks",
                format!(
                    "the same motion as at once with receptive_codes {}",
                    manifest.decoder.receptive_codes
                ),
                format!("a difference of {worst} m"),
            ));
        }
        Ok(())
    }

    /// Two codes by the path that requests take; it also warms the step up.
    fn try_sampling(&mut self) -> Result<()> {
        let columns = self.directory.manifest().features.columns;
        let job = Job {
            music: Array2::zeros((3, columns)),
            sampling: Sampling {
                temperature: 1.0,
                top_k: None,
            },
            // Two branches, if that is the default.
            guidance: self.directory.manifest().sampling.guidance,
            candidates: self.directory.manifest().sampling.candidates,
            beats: vec![4, 12, 20],
            seed: 0,
            start: [None, None],
            window: Window::new(WindowKind::Hop, 1, 2),
            progress: Arc::new(()),
            cancel: CancelToken::new(),
        };
        self.run(&job, Duration::ZERO).map(drop)
    }

    /// One request's codes and motion.
    pub(crate) fn run(&mut self, job: &Job, queued: Duration) -> Result<Outcome> {
        let started = Instant::now();
        let manifest = self.directory.manifest();
        let mut sampler = Sampler::new(job.sampling, job.seed);
        let start = start_codes(job.start, manifest, &mut sampler);
        let guide = Guide::new(job.guidance, job.music.view());
        let request = Request {
            music: job.music.view(),
            guide: guide.as_ref(),
            start,
            window: job.window,
            progress: job.progress.as_ref(),
            cancel: &job.cancel,
        };
        let codes = if job.has_a_choice() {
            let mut search = Search {
                candidates: job.candidates,
                beats: &job.beats,
                decoder: &mut self.decoder,
                manifest,
            };
            search.generate_codes(&mut self.gpt, &mut sampler, &request)?
        } else {
            generate_codes(&mut self.gpt, &mut sampler, &request).map_err(of_model)?
        };
        job.progress.stage(Stage::Motion);
        let decoded =
            decode_codes(&mut self.decoder, &codes, manifest, &job.cancel).map_err(of_model)?;
        let motion = manifest.motion_frame.into_world(decoded)?;
        Ok(Outcome {
            codes,
            motion,
            queued,
            inference: started.elapsed(),
        })
    }
}

/// The start pair: given codes win; the rest is drawn as a pair from the manifest's list, or from
/// the whole vocabulary when it has none. Both numbers are drawn always, so that giving one half
/// does not change the dance's other draws.
fn start_codes(given: [Option<u32>; 2], manifest: &Manifest, sampler: &mut Sampler) -> [u32; 2] {
    let vocabulary = manifest.vocabulary;
    let drawn = match manifest.start_codes.as_slice() {
        [] => [
            sampler.uniform(vocabulary.upper) as u32,
            sampler.uniform(vocabulary.lower) as u32,
        ],
        pairs => pairs
            .get(sampler.uniform(pairs.len()))
            .copied()
            .unwrap_or_default(),
    };
    [given[0].unwrap_or(drawn[0]), given[1].unwrap_or(drawn[1])]
}

fn misfit(what: &'static str, expected: String, got: String) -> Error {
    ModelError::Input {
        what,
        expected,
        got,
    }
    .into()
}
