//! A generation as callers ask for it, and its result.

use std::sync::Arc;

use bytes::Bytes;
use ndarray::Array2;

use super::{GenerationOptions, MotionStream, Progress};
use crate::{
    formats::{Codes, Continuation, GeneratedMotion, MusicInfo, Timings},
    model::Manifest,
    motion::Finished,
};

/// One generation: music, options, and receivers of its progress and motion.
pub struct GenerationRequest {
    /// The music.
    pub music: MusicSource,
    /// What the caller chose.
    pub options: GenerationOptions,
    /// Receives the progress.
    pub progress: Arc<dyn Progress>,
    /// Receives the motion as it is decoded, in place of the output.
    pub stream: Option<Arc<dyn MotionStream>>,
    /// Longest song in seconds, where that is less than the engine's limit.
    pub longest: Option<f64>,
    /// Whose it is: owners share the model's time equally, however many requests each has.
    pub owner: u64,
}

/// The music of a request.
pub enum MusicSource {
    /// An audio file: wav, aiff, flac, mp3, ogg, webm (vorbis, opus) or m4a (aac, alac).
    Audio(Bytes),
    /// Feature rows `[rows, columns]` as the manifest's features say. They carry no beats to the
    /// frame, so that there is one candidate for every segment.
    Features(Array2<f32>),
    /// None: the options carry the codes to dance.
    None,
}

impl GenerationRequest {
    /// A motion to an audio file.
    #[must_use]
    pub fn audio(audio: impl Into<Bytes>, options: GenerationOptions) -> Self {
        Self::new(MusicSource::Audio(audio.into()), options)
    }

    /// Codes and decoded motion to given feature rows.
    #[must_use]
    pub fn features(rows: Array2<f32>, options: GenerationOptions) -> Self {
        Self::new(MusicSource::Features(rows), options)
    }

    /// A motion of the codes that `options` carry.
    #[must_use]
    pub fn codes(options: GenerationOptions) -> Self {
        Self::new(MusicSource::None, options)
    }

    fn new(music: MusicSource, options: GenerationOptions) -> Self {
        Self { music, options, progress: Arc::new(()), stream: None, longest: None, owner: 0 }
    }

    /// Reports to `progress`.
    #[must_use]
    pub fn with_progress(self, progress: Arc<dyn Progress>) -> Self {
        Self { progress, ..self }
    }

    /// Refuses a song that is longer, as soon as so much of it is decoded.
    #[must_use]
    pub fn within(self, seconds: f64) -> Self {
        Self { longest: Some(seconds), ..self }
    }

    /// Counts it as one of `owner`'s.
    #[must_use]
    pub fn owned_by(self, owner: u64) -> Self {
        Self { owner, ..self }
    }

    /// Sends the motion to `stream` as it is decoded.
    #[must_use]
    pub fn streamed_to(self, stream: Arc<dyn MotionStream>) -> Self {
        Self { stream: Some(stream), ..self }
    }
}

/// The result of a generation.
#[derive(Clone, Debug)]
pub struct GenerationOutput {
    /// The seed that was used.
    pub seed: u64,
    /// The pose codes.
    pub codes: Codes,
    /// The motion.
    pub motion: MotionOutput,
    /// Style of the dance, or `mixed`; none from a model without styles.
    pub style: Option<String>,
    /// Tempo and beats, when asked for.
    pub music: Option<MusicInfo>,
    /// Wall time per stage.
    pub timings: Timings,
    /// What was trimmed, truncated or assumed, in plain words.
    pub warnings: Vec<String>,
    /// Seconds from the start of the song to the first frame.
    pub song_start_s: f64,
    /// Where another dance can continue.
    pub tail: Option<Continuation>,
}

/// The motion of a generation.
#[derive(Clone, Debug)]
pub enum MotionOutput {
    /// To audio, or of given codes: on the floor, with rotations, at the wanted frame rate.
    Finished(Finished),
    /// To feature rows: as decoded, `[frames, 3 joints]` in world directions, root velocity in
    /// columns 0..3, other joints relative to the root.
    Decoded(Array2<f32>),
    /// The request's stream received it.
    Streamed,
}

impl GenerationOutput {
    /// The output as a dance that can be written to a file.
    ///
    /// # Panics
    /// If the motion is not finished: the request was one to feature rows, or for a stream.
    #[must_use]
    pub fn into_motion(self, manifest: &Manifest) -> GeneratedMotion {
        let MotionOutput::Finished(finished) = self.motion else {
            unreachable!("only the motion of a request to audio without a stream is finished");
        };
        GeneratedMotion {
            model: manifest.name.clone(),
            seed: self.seed,
            skeleton: manifest.skeleton.clone(),
            animation: finished.animation,
            positions: finished.positions,
            positions_source: finished.source,
            codes: self.codes,
            style: self.style,
            music: self.music,
            timings: self.timings,
            warnings: self.warnings,
            song_start_s: self.song_start_s,
            continuation: self.tail,
        }
    }

    /// The decoded motion of a request to feature rows, `[frames, 3 joints]`.
    ///
    /// # Panics
    /// If the request was another one.
    #[must_use]
    pub fn into_decoded(self) -> Array2<f32> {
        let MotionOutput::Decoded(motion) = self.motion else {
            unreachable!("only a request to feature rows gives decoded motion");
        };
        motion
    }
}
