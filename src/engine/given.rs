//! Dances of given codes: choreography as a selection of codes (paper, section 3.1).

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use parking_lot::Mutex;

use super::{
    EngineError, GenerationOptions, MusicSource, Stage,
    chunks::ChunkPlan,
    decoding::{ChunkTask, DecodeTask, LastChunk, MotionBuffer, MotionSink},
    frontend::Selection,
    prepare::{AcceptedRequest, Preparer, decoded_length},
};
use crate::{
    formats::Codes,
    model::{Manifest, code_pairs},
};

/// Refuses options that do not go with the music.
pub(super) fn check_music(
    music: &MusicSource,
    options: &GenerationOptions,
) -> Result<(), EngineError> {
    let has_codes = options.codes.is_some();
    let (name, problem) = match music {
        MusicSource::None if !has_codes => ("codes", "give them, or a song to choose them by"),
        MusicSource::None if options.range.offset_s > 0.0 => {
            ("offset_s", "codes alone have no song to start in: send it too, or leave this out")
        }
        MusicSource::Features(_) if has_codes => {
            ("codes", "feature rows are there to choose codes by: give either")
        }
        _ => return Ok(()),
    };
    Err(EngineError::Option { name, problem: problem.into() })
}

/// Refuses codes for a dance that is longer than the longest song, of `most` seconds.
pub(super) fn check_length(
    options: &GenerationOptions,
    manifest: &Manifest,
    most: f64,
) -> Result<(), EngineError> {
    let Some(codes) = &options.codes else {
        return Ok(());
    };
    let seconds = codes.upper.len() as f64 / manifest.codes_per_second();
    if options.range.duration_s.unwrap_or(seconds).min(seconds) <= most {
        return Ok(());
    }
    let problem = format!("they last {seconds:.1} s, and at most {most} s are accepted");
    Err(EngineError::Option { name: "codes", problem })
}

impl Preparer {
    /// Decodes the codes of the caller. A song is listened to for what is told of it.
    ///
    /// # Errors
    /// Whatever is wrong with the song; [`EngineError::Stopped`].
    pub(super) fn decode_given(
        &self,
        codes: Codes,
        audio: Option<Bytes>,
        mut request: AcceptedRequest,
    ) -> Result<(), EngineError> {
        request.prologue.timings.queue = request.submitted.elapsed();
        let heard = audio.map(|audio| self.listen(audio, &mut request)).transpose()?.flatten();
        let mut pairs = code_pairs(&codes.upper, &codes.lower)
            .unwrap_or_else(|_| unreachable!("the options were checked"));
        let manifest = self.directory.manifest();
        let (per_code, fps) = (manifest.frames_per_code, manifest.fps);
        let options = &request.options;
        let prompt = &request.prologue.prompt;
        let all = prompt.frames_with(pairs.len(), per_code);
        let seconds = all as f64 / f64::from(fps);
        let seconds = options.range.duration_s.map_or(seconds, |wanted| wanted.min(seconds));
        let length = decoded_length(seconds, options.fps, fps).min(all);
        // As many codes as a song of this length has rows, so that its dance comes out again.
        let own = length.saturating_sub(prompt.frames_with(0, per_code));
        pairs.truncate(own / per_code + 1);
        if let Some(heard) =
            heard.filter(|heard| heard + 1.0 / manifest.codes_per_second() < seconds)
        {
            let warning =
                format!("the codes last {seconds:.1} s, the song only {heard:.1} s of it");
            request.prologue.warnings.push(warning);
        }
        request.prologue.length = Some(length);
        if heard.is_none() {
            request.progress.decoded(seconds);
        }
        let sink = self.finishing_sink(&mut request, pairs.len())?;
        self.send_chunks(pairs, request, sink)
    }

    /// Finds the music of a song, and returns how many seconds of it there are.
    fn listen(
        &self,
        audio: Bytes,
        request: &mut AcceptedRequest,
    ) -> Result<Option<f64>, EngineError> {
        let options = &request.options;
        let selection = Selection {
            range: options.range,
            longest: request.longest,
            music: options.music,
            is_chosen: false,
            form: false,
        };
        let cancel = request.completion.token();
        let timings = &mut request.prologue.timings;
        let progress = &*request.progress;
        let mut heard = self.frontend.condition(audio, selection, &cancel, progress, timings)?;
        request.prologue.warnings = std::mem::take(&mut heard.warnings);
        request.prologue.music = heard.take_music_from(0);
        Ok(heard.seconds)
    }

    /// Sends all codes to the decoder thread, in chunks; waits where that is busy.
    fn send_chunks(
        &self,
        pairs: Vec<[u32; 2]>,
        request: AcceptedRequest,
        sink: MotionSink,
    ) -> Result<(), EngineError> {
        let AcceptedRequest { prologue, progress, completion, .. } = request;
        progress.stage(Stage::Motion);
        progress.codes(pairs.len(), pairs.len());
        let mut prompt = prologue.prompt.codes.clone();
        // A motion that begins inside the prompt's last code decodes that again.
        let resumed = prompt.pop_if(|_| prologue.prompt.shown > 0);
        let codes: Vec<_> = resumed.into_iter().chain(pairs.iter().copied()).collect();
        let receptive = self.directory.manifest().decoder.receptive_codes;
        let plan = ChunkPlan::new(codes.len(), prompt, receptive);
        let mut plan = match sink {
            MotionSink::Stream(_) => plan.soon(),
            MotionSink::Finish(_) | MotionSink::Keep(_) => plan,
        };
        let motion = Arc::new(Mutex::new(MotionBuffer::new(prologue, sink, progress)));
        let (started, queued) = (Instant::now(), Duration::ZERO);
        while let Some(chunk) = plan.next(&codes).filter(|_| completion.is_wanted()) {
            let last = plan.is_complete();
            let last = last.then(|| LastChunk { codes: pairs.clone(), queued, started });
            let (motion, completion) = (Arc::clone(&motion), Arc::clone(&completion));
            let task = DecodeTask::Chunk(ChunkTask { motion, completion, chunk, last });
            self.decoding.send(task).map_err(|_| EngineError::Stopped)?;
        }
        Ok(())
    }
}
