//! From an accepted request to one that the scheduler takes.

use std::{sync::Arc, time::Instant};

use bytes::Bytes;
use ndarray::Array2;

use super::{
    EngineError, GenerationOptions, MotionStream, Opening, Progress, Stage,
    completion::Completion,
    conditioning::Conditioning,
    decoding::{MotionBuffer, MotionSink, Prologue},
    frontend::{AudioFrontend, Selection},
    queue::{Entry, Queue},
    scheduler::ScheduledRequest,
    sequence::SequenceRequest,
};
use crate::{
    model::ModelDirectory,
    motion::{FinishOptions, Finisher, PositionsSource},
};

/// A request whose options were checked.
pub(crate) struct AcceptedRequest {
    pub(crate) options: GenerationOptions,
    pub(crate) progress: Arc<dyn Progress>,
    pub(crate) stream: Option<Arc<dyn MotionStream>>,
    pub(crate) prologue: Prologue,
    pub(crate) completion: Arc<Completion>,
    pub(crate) submitted: Instant,
    pub(crate) owner: u64,
}

/// An accepted request whose song is not decoded yet.
pub(crate) struct AudioRequest {
    pub(crate) audio: Bytes,
    pub(crate) request: AcceptedRequest,
}

impl Entry for AudioRequest {
    fn is_wanted(&self) -> bool {
        self.request.completion.is_wanted()
    }
}

/// Prepares requests for the scheduler of one model.
pub(crate) struct Preparer {
    pub(crate) directory: Arc<ModelDirectory>,
    pub(crate) frontend: AudioFrontend,
    /// Rows of the batch.
    pub(crate) rows: usize,
    pub(crate) scheduled: Arc<Queue<ScheduledRequest>>,
}

impl Preparer {
    /// Decodes a song, computes its features and schedules the request.
    ///
    /// # Errors
    /// Whatever is wrong with the song; [`EngineError::QueueFull`].
    pub(crate) fn schedule_audio(&self, audio: AudioRequest) -> Result<(), EngineError> {
        let AudioRequest { audio, mut request } = audio;
        let manifest = self.directory.manifest();
        let options = &request.options;
        let selection = Selection {
            range: options.range,
            music: options.music,
            is_chosen: options.candidates(manifest, self.rows) > 1,
        };
        let cancel = request.completion.token();
        let timings = &mut request.prologue.timings;
        timings.queue = request.submitted.elapsed();
        let progress = &*request.progress;
        let frontend = &self.frontend;
        let mut conditioning = frontend.condition(audio, selection, &cancel, progress, timings)?;
        request.prologue.warnings = std::mem::take(&mut conditioning.warnings);
        request.prologue.music = conditioning.music.take();
        let sink = match request.stream.take() {
            None => {
                let options = finish_options(&request, self.directory.manifest().fps);
                let skeleton = &manifest.skeleton;
                MotionSink::Finish(Box::new(Finisher::whole(skeleton, &options)?))
            }
            Some(stream) => self.open_stream(stream, &request, &conditioning)?,
        };
        self.schedule(request, conditioning, sink)
    }

    /// Schedules a request to feature rows.
    ///
    /// # Errors
    /// [`EngineError::Option`] for rows that do not fit the model; [`EngineError::QueueFull`].
    pub(crate) fn schedule_features(
        &self,
        rows: Array2<f32>,
        request: AcceptedRequest,
    ) -> Result<(), EngineError> {
        let columns = self.directory.manifest().features.columns;
        self.schedule_conditioned(Conditioning::new(rows, Vec::new(), columns)?, request)
    }

    /// Schedules a request whose motion is wanted as it is decoded.
    ///
    /// # Errors
    /// [`EngineError::QueueFull`].
    pub(crate) fn schedule_conditioned(
        &self,
        conditioning: Conditioning,
        mut request: AcceptedRequest,
    ) -> Result<(), EngineError> {
        let sink = match request.stream.take() {
            None => MotionSink::Keep(Array2::default((0, 0))),
            Some(stream) => self.open_stream(stream, &request, &conditioning)?,
        };
        self.schedule(request, conditioning, sink)
    }

    fn schedule(
        &self,
        request: AcceptedRequest,
        conditioning: Conditioning,
        sink: MotionSink,
    ) -> Result<(), EngineError> {
        request.progress.stage(Stage::Generating);
        let manifest = self.directory.manifest();
        let prompt = request.prologue.prompt.codes.clone();
        let conditioning = match prompt.is_empty() {
            true => conditioning,
            false => conditioning.after_prompt(manifest.frames_per_code),
        };
        let seed = request.prologue.seed;
        let sequence = SequenceRequest {
            conditioning,
            params: request.options.resolve(manifest, self.rows, seed),
            prompt,
            progress: Arc::clone(&request.progress),
            soon: matches!(sink, MotionSink::Stream(_)),
        };
        self.scheduled.push(ScheduledRequest {
            sequence,
            motion: MotionBuffer::new(request.prologue, sink, request.progress),
            completion: request.completion,
            submitted: Instant::now(),
            owner: request.owner,
        })
    }

    /// Says what a streamed motion will be.
    fn open_stream(
        &self,
        stream: Arc<dyn MotionStream>,
        request: &AcceptedRequest,
        conditioning: &Conditioning,
    ) -> Result<MotionSink, EngineError> {
        let rows = conditioning.features.nrows();
        let manifest = self.directory.manifest();
        let finish = finish_options(request, manifest.fps);
        let decoded = (rows * manifest.frames_per_code) as u64;
        let frames = (decoded * u64::from(finish.fps)).div_ceil(u64::from(finish.decoded_fps));
        let prologue = &request.prologue;
        stream.opened(Opening {
            model: manifest.name.clone(),
            seed: prologue.seed,
            skeleton: manifest.skeleton.clone(),
            fps: finish.fps,
            frames: frames as usize,
            positions_source: match finish.fps == finish.decoded_fps {
                true => PositionsSource::Decoder,
                false => PositionsSource::ForwardKinematics,
            },
            music: prologue.music.clone(),
            timings: prologue.timings,
            warnings: prologue.warnings.clone(),
            finisher: Finisher::new(&manifest.skeleton, &finish)?,
        });
        Ok(MotionSink::Stream(stream))
    }
}

fn finish_options(request: &AcceptedRequest, decoded_fps: u32) -> FinishOptions {
    FinishOptions {
        fps: request.options.fps,
        root_motion: request.options.root_motion,
        decoded_fps,
        start: request.prologue.prompt.place,
    }
}
