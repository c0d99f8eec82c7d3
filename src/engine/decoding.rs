//! The decoder thread, which makes motion of codes beside the thread that chooses them: a chunk
//! takes as long as dozens of steps.

use std::{
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, bounded};
use ndarray::{Array2, Axis};
use parking_lot::Mutex;
use tokio::sync::oneshot;
use tracing::Span;

use super::{
    EngineError, GenerationOptions, GenerationOutput, MotionOutput, MotionStream, Progress, Stage,
    chunk_decoder::ChunkDecoder,
    chunks::Chunk,
    code_model::SharedDecoder,
    completion::Completion,
    observer::guarded,
    pose::pose,
    progress::spent,
    prompt::{Ending, Moved, Prompt},
};
use crate::{
    formats::{Codes, MusicInfo, Timings},
    model::ModelDirectory,
    motion::{Finisher, Positions, ToWorld},
};

/// The part of an output that is known before its motion.
pub(crate) struct Prologue {
    pub(crate) directory: Arc<ModelDirectory>,
    pub(crate) seed: u64,
    pub(crate) prompt: Prompt,
    pub(crate) moved: Moved,
    /// Where in the song the motion begins, in seconds.
    pub(crate) song_start_s: f64,
    /// Frames of decoded motion that are wanted, once the length of the song is known.
    pub(crate) length: Option<usize>,
    pub(crate) music: Option<MusicInfo>,
    /// Style of the dance; none from a model without styles.
    pub(crate) style: Option<String>,
    pub(crate) timings: Timings,
    pub(crate) warnings: Vec<String>,
    /// The request's span.
    pub(crate) span: Span,
}

impl Prologue {
    /// For a request of these options; nothing is known of its music yet.
    pub(crate) fn new(
        directory: Arc<ModelDirectory>,
        options: &GenerationOptions,
        seed: u64,
    ) -> Self {
        Self {
            directory,
            seed,
            prompt: Prompt::of(options),
            song_start_s: options.range.offset_s,
            moved: Moved { travels: options.root_motion, mirrored: options.mirror },
            length: None,
            music: None,
            style: None,
            timings: Timings::default(),
            warnings: Vec::new(),
            span: Span::current(),
        }
    }
}

/// Where decoded motion goes.
pub(crate) enum MotionSink {
    /// It is finished piece by piece.
    Finish(Box<Finisher>),
    /// It is kept as it is.
    Keep(Array2<f32>),
    Stream(Arc<dyn MotionStream>),
}

/// The motion of one request, as far as it is decoded.
pub(crate) struct MotionBuffer {
    chunks: ChunkDecoder,
    sink: MotionSink,
    prologue: Prologue,
    progress: Arc<dyn Progress>,
    /// When the latest chunk was decoded.
    decoded: Instant,
}

impl MotionBuffer {
    pub(crate) fn new(prologue: Prologue, sink: MotionSink, progress: Arc<dyn Progress>) -> Self {
        let Prompt { codes, heading, shown, .. } = &prologue.prompt;
        let frame = prologue.directory.manifest().motion_frame;
        // What is shown turns the other way in a mirror.
        let heading = if prologue.moved.mirrored { -*heading } else { *heading };
        let to_world = ToWorld::new(frame, f64::from(heading));
        Self {
            chunks: ChunkDecoder::new(codes.clone(), to_world)
                .resuming(*shown)
                .ending_after(prologue.length),
            sink,
            prologue,
            progress,
            decoded: Instant::now(),
        }
    }

    fn push(&mut self, chunk: &Chunk, decoder: &SharedDecoder) -> Result<(), EngineError> {
        // The decoder is free again before anything is done with the frames.
        let motion = self.chunks.decode(chunk, &mut *decoder.lock())?;
        self.decoded = Instant::now();
        match &mut self.sink {
            MotionSink::Stream(stream) => stream.frames(motion),
            MotionSink::Keep(kept) if kept.is_empty() => *kept = motion,
            MotionSink::Keep(kept) => kept
                .append(Axis(0), motion.view())
                .unwrap_or_else(|_| unreachable!("all chunks have the same columns")),
            MotionSink::Finish(finisher) => {
                let mut took = Duration::ZERO;
                let span = &self.prologue.span;
                let pushed =
                    span.in_scope(|| spent(&mut took, "motion", || finisher.push(motion.view())));
                self.prologue.timings.motion += took;
                pushed?;
            }
        }
        Ok(())
    }

    /// The output, after the last chunk.
    fn finish(&mut self, last: LastChunk) -> Result<GenerationOutput, EngineError> {
        self.progress.stage(Stage::Motion);
        let prologue = &mut self.prologue;
        prologue.timings.queue += last.queued;
        prologue.timings.inference = self.decoded - last.started;
        let mut seam = None;
        let motion = match &mut self.sink {
            MotionSink::Stream(_) => MotionOutput::Streamed,
            MotionSink::Keep(kept) => MotionOutput::Decoded(std::mem::take(kept)),
            MotionSink::Finish(finisher) => {
                let mut took = Duration::ZERO;
                let finished = spent(&mut took, "motion", || finisher.end());
                prologue.timings.motion += took;
                seam = finisher.seam();
                MotionOutput::Finished(finished?)
            }
        };
        let (walked, heading) = self.chunks.end();
        let ending = Ending { walked, heading: heading as f32, frames: self.chunks.frames() };
        let codes = &last.codes;
        let prompt = &prologue.prompt;
        let tail = prompt.tail(codes, ending, prologue.moved, &prologue.directory);
        Ok(GenerationOutput {
            seed: prologue.seed,
            codes: Codes::of_pairs(codes),
            motion,
            style: prologue.style.take(),
            music: prologue.music.take(),
            timings: prologue.timings,
            warnings: std::mem::take(&mut prologue.warnings),
            song_start_s: prologue.song_start_s,
            tail: tail.map(|tail| tail.with_seam(seam)),
        })
    }
}

/// Work for the decoder thread.
pub(crate) enum DecodeTask {
    Chunk(ChunkTask),
    /// A pair of codes alone.
    Pose {
        codes: [u32; 2],
        directory: Arc<ModelDirectory>,
        positions: oneshot::Sender<Result<Positions, EngineError>>,
    },
}

/// The next chunk of a request's motion.
pub(crate) struct ChunkTask {
    pub(crate) motion: Arc<Mutex<MotionBuffer>>,
    pub(crate) completion: Arc<Completion>,
    pub(crate) chunk: Chunk,
    /// With the last one.
    pub(crate) last: Option<LastChunk>,
}

/// What completes an output besides its motion.
pub(crate) struct LastChunk {
    pub(crate) codes: Vec<[u32; 2]>,
    pub(crate) queued: Duration,
    /// When the first step was taken.
    pub(crate) started: Instant,
}

impl DecodeTask {
    fn run(self, decoder: &SharedDecoder) {
        match self {
            Self::Chunk(task) => task.run(decoder),
            Self::Pose { codes, directory, positions } => {
                let shown = guarded(|| pose(codes, decoder, directory.manifest()));
                // The caller may have gone.
                let _ = positions.send(shown);
            }
        }
    }
}

impl ChunkTask {
    fn run(self, decoder: &SharedDecoder) {
        // A request that failed, or was cancelled, needs no more frames.
        if !self.completion.is_wanted() {
            return;
        }
        let decoded = guarded(|| {
            let mut motion = self.motion.lock();
            motion.push(&self.chunk, decoder)?;
            self.last.map(|last| motion.finish(last)).transpose()
        });
        // What the request holds is free before its caller knows of the result.
        drop(self.motion);
        match decoded {
            Ok(None) => {}
            Ok(Some(output)) => self.completion.complete(Ok(output)),
            Err(error) => self.completion.complete(Err(error)),
        }
    }
}

/// Starts the decoder thread, which ends when all senders are dropped; `waiting` tasks may wait.
///
/// # Errors
/// [`EngineError::NoThread`].
pub(crate) fn start(
    decoder: SharedDecoder,
    waiting: usize,
) -> Result<Sender<DecodeTask>, EngineError> {
    let (sender, tasks): (_, Receiver<DecodeTask>) = bounded(waiting);
    thread::Builder::new()
        .name("decoder".into())
        .spawn(move || tasks.into_iter().for_each(|task| task.run(&decoder)))
        .map_err(EngineError::NoThread)?;
    Ok(sender)
}
