//! From an accepted request to one that the scheduler takes.

use std::{sync::Arc, time::Instant};

use bytes::Bytes;
use crossbeam_channel::Sender;
use ndarray::Array2;

use super::{
    EngineError, GenerationOptions, MotionStream, Opening, Progress, Stage,
    completion::Completion,
    conditioning::Conditioning,
    decoding::{DecodeTask, MotionBuffer, MotionSink, Prologue},
    form::FORM,
    frontend::{AudioFrontend, Selection},
    queue::{Entry, Queue},
    scheduler::ScheduledRequest,
    sequence::SequenceRequest,
};
use crate::{
    audio::AudioRange,
    model::{Manifest, ModelDirectory, StyleClassifier},
    motion::{FinishOptions, Finisher},
};

/// A request whose options were checked.
pub(crate) struct AcceptedRequest {
    pub(crate) options: GenerationOptions,
    pub(crate) progress: Arc<dyn Progress>,
    pub(crate) stream: Option<Arc<dyn MotionStream>>,
    pub(crate) prologue: Prologue,
    pub(crate) completion: Arc<Completion>,
    pub(crate) submitted: Instant,
    /// Longest song in seconds, where that is less than the frontend's limit.
    pub(crate) longest: Option<f64>,
    pub(crate) owner: u64,
}

/// An accepted request whose song is not decoded yet.
pub(crate) struct AudioRequest {
    /// None where codes are given, which need none.
    pub(crate) audio: Option<Bytes>,
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
    /// Finds the style of a song, where the model has a classifier.
    pub(crate) classifier: Option<StyleClassifier>,
    /// Rows of the batch.
    pub(crate) rows: usize,
    pub(crate) scheduled: Arc<Queue<ScheduledRequest>>,
    /// The decoder thread.
    pub(crate) decoding: Sender<DecodeTask>,
}

impl Preparer {
    /// Decodes a song, computes its features and schedules the request.
    ///
    /// # Errors
    /// Whatever is wrong with the song; [`EngineError::QueueFull`].
    pub(crate) fn schedule_audio(&self, audio: AudioRequest) -> Result<(), EngineError> {
        let AudioRequest { audio, mut request } = audio;
        if let Some(codes) = request.options.codes.take() {
            return self.decode_given(codes, audio, request);
        }
        let audio = audio.unwrap_or_else(|| unreachable!("`check_music` has found a song"));
        let manifest = self.directory.manifest();
        let options = &request.options;
        let lead = lead(&request, manifest);
        let selection = Selection {
            range: from_lead(options.range, lead, manifest.fps),
            longest: request.longest,
            music: options.music,
            is_chosen: options.candidates(manifest, self.rows) > 1,
            form: options.form.unwrap_or(FORM),
        };
        let cancel = request.completion.token();
        let timings = &mut request.prologue.timings;
        timings.queue = request.submitted.elapsed();
        let progress = &*request.progress;
        let frontend = &self.frontend;
        let mut conditioning = frontend.condition(audio, selection, &cancel, progress, timings)?;
        request.prologue.warnings = std::mem::take(&mut conditioning.warnings);
        request.prologue.music = conditioning.take_music_from(lead);
        request.prologue.length = conditioning.seconds.map(|seconds| {
            let seconds = seconds - lead as f64 / f64::from(manifest.fps);
            decoded_length(seconds, options.fps, manifest.fps)
        });
        // The row of the prompt's last code is there where its music is.
        if lead == 0 && !request.prologue.prompt.codes.is_empty() {
            conditioning = conditioning.after_prompt(manifest.frames_per_code);
        }
        let conditioning = self.in_manner(conditioning, &mut request);
        let codes = conditioning.features.nrows() - request.prologue.prompt.given();
        let sink = self.finishing_sink(&mut request, codes)?;
        self.schedule(request, conditioning, sink)
    }

    /// Where a motion of so many new codes goes that is finished: the request's stream, if it has
    /// one.
    pub(super) fn finishing_sink(
        &self,
        request: &mut AcceptedRequest,
        codes: usize,
    ) -> Result<MotionSink, EngineError> {
        if let Some(stream) = request.stream.take() {
            return self.open_stream(stream, request, codes);
        }
        let manifest = self.directory.manifest();
        let options = finish_options(request, manifest.fps);
        let finisher = Finisher::whole(&manifest.skeleton, &options)?;
        Ok(MotionSink::Finish(Box::new(joined(finisher, request)?)))
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
        mut conditioning: Conditioning,
        mut request: AcceptedRequest,
    ) -> Result<(), EngineError> {
        if !request.prologue.prompt.codes.is_empty() {
            let per_code = self.directory.manifest().frames_per_code;
            conditioning = conditioning.after_prompt(per_code);
        }
        let conditioning = self.in_manner(conditioning, &mut request);
        let sink = match request.stream.take() {
            None => MotionSink::Keep(Array2::default((0, 0))),
            Some(stream) => {
                let codes = conditioning.features.nrows() - request.prologue.prompt.given();
                self.open_stream(stream, &request, codes)?
            }
        };
        self.schedule(request, conditioning, sink)
    }

    /// Adds the columns of the manner that is asked for, and notes its style.
    fn in_manner(
        &self,
        mut conditioning: Conditioning,
        request: &mut AcceptedRequest,
    ) -> Conditioning {
        let manifest = self.directory.manifest();
        let features = conditioning.features.view();
        let (manner, style) = request.options.manner(manifest, self.classifier.as_ref(), features);
        request.prologue.style = style;
        let manners = manifest.manners();
        if manners.columns() > 0 {
            conditioning.features = manners.beside(features, manner);
        }
        conditioning
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
        let seed = request.prologue.seed;
        let sequence = SequenceRequest {
            conditioning,
            params: request.options.resolve(manifest, self.rows, seed),
            prompt,
            style: request.prologue.style.clone(),
            resumes: request.prologue.prompt.shown > 0,
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
        codes: usize,
    ) -> Result<MotionSink, EngineError> {
        let manifest = self.directory.manifest();
        let finish = finish_options(request, manifest.fps);
        let prologue = &request.prologue;
        let all = prologue.prompt.frames_with(codes, manifest.frames_per_code);
        let decoded = prologue.length.map_or(all, |length| length.min(all)) as u64;
        let frames = (decoded * u64::from(finish.fps)).div_ceil(u64::from(finish.decoded_fps));
        stream.opened(Opening {
            model: manifest.name.clone(),
            seed: prologue.seed,
            skeleton: manifest.skeleton.clone(),
            fps: finish.fps,
            frames: frames as usize,
            positions_source: finish.positions,
            style: prologue.style.clone(),
            music: prologue.music.clone(),
            timings: prologue.timings,
            warnings: prologue.warnings.clone(),
            finisher: joined(Finisher::new(&manifest.skeleton, &finish)?, request)?,
        });
        Ok(MotionSink::Stream(stream))
    }
}

fn finish_options(request: &AcceptedRequest, decoded_fps: u32) -> FinishOptions {
    let options = &request.options;
    FinishOptions {
        fps: options.fps,
        root_motion: options.root_motion,
        mirror: options.mirror,
        decoded_fps,
        start: request.prologue.prompt.place,
        clean: options.clean,
        positions: options.positions,
    }
}

/// The finisher, beginning where the motion before ended.
fn joined(finisher: Finisher, request: &AcceptedRequest) -> Result<Finisher, EngineError> {
    match &request.prologue.prompt.seam {
        Some(seam) => Ok(finisher.continuing(seam.clone())?),
        None => Ok(finisher),
    }
}

/// Frames of the prompt's last code whose music lies before the part of the song that is wanted;
/// 0 where the song does not reach back to them.
fn lead(request: &AcceptedRequest, manifest: &Manifest) -> usize {
    let shown = request.prologue.prompt.shown;
    let seconds = shown as f64 / f64::from(manifest.fps);
    if request.options.range.offset_s < seconds { 0 } else { shown }
}

/// The range from so many frames before it.
fn from_lead(range: AudioRange, lead: usize, fps: u32) -> AudioRange {
    let seconds = lead as f64 / f64::from(fps);
    AudioRange {
        offset_s: range.offset_s - seconds,
        duration_s: range.duration_s.map(|duration| duration + seconds),
    }
}

/// Frames to decode for `round(seconds * fps)` frames at `fps`: so many that interpolation between
/// them gives no frame more.
pub(super) fn decoded_length(seconds: f64, fps: u32, decoded_fps: u32) -> usize {
    let frames = (seconds * f64::from(fps)).round().max(1.0) as u64;
    (frames * u64::from(decoded_fps) / u64::from(fps)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::FRAME_RATES;

    #[test]
    fn the_length_is_that_of_the_music_to_the_frame_at_every_rate() {
        for fps in FRAME_RATES {
            for hundredths in 100..3000 {
                let seconds = f64::from(hundredths) / 100.0;
                let decoded = decoded_length(seconds, fps, 60) as u64;
                let frames = (decoded * u64::from(fps)).div_ceil(60);
                assert_eq!(frames, (seconds * f64::from(fps)).round() as u64, "{seconds} at {fps}");
            }
        }
    }

    #[test]
    fn a_lead_moves_the_start_and_keeps_the_end() {
        let range = AudioRange { offset_s: 2.0, duration_s: Some(3.0) };
        let AudioRange { offset_s, duration_s } = from_lead(range, 6, 60);
        assert!((offset_s - 1.9).abs() < 1e-12 && (duration_s.unwrap() - 3.1).abs() < 1e-12);
    }
}
