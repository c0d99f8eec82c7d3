//! The blocking part of a request, off the async threads.

use std::sync::Arc;

use bytes::Bytes;
use tracing::Span;

use super::{
    config::Limits,
    envelope::panic_text,
    error::ServerError,
    intake::Order,
    metrics::SharedMetrics,
    options::RequestOptions,
    resources::Permit,
    state::{Generate, SharedState},
    watch::{Phase, Watch},
};
use crate::{
    Error,
    audio::AudioError,
    engine::{Ending, GenerationOptions, Listener},
    formats::{GeneratedMotion, OutputFormat},
};

/// What the engine is asked for.
pub(crate) struct Work {
    engine: Arc<dyn Generate>,
    audio: Bytes,
    options: GenerationOptions,
    watch: Arc<Watch>,
}

impl Order {
    /// What the engine is asked for; the audio goes with it.
    pub(crate) fn work(&mut self) -> Work {
        Work {
            engine: Arc::clone(&self.engine),
            audio: std::mem::take(&mut self.audio),
            options: self.options.generation(self.shape.format),
            watch: Arc::clone(&self.watch),
        }
    }

    /// Waits for room for the song's seconds; how long it is, is known once it is decoded.
    pub(crate) async fn hold_audio(&self, state: &SharedState) -> Result<(), ServerError> {
        let seconds = self.most_seconds(&state.limits);
        self.watch
            .hold_audio(state.resources.audio.reserve(seconds).await);
        Ok(())
    }

    /// The most whole seconds that the dance can take.
    pub(crate) fn most_seconds(&self, limits: &Limits) -> u64 {
        let longest = limits.max_audio_seconds;
        let asked = self.options.longest_seconds().unwrap_or(longest);
        asked.min(longest).ceil() as u64
    }
}

/// A dance, and the right to work that it came about by.
pub(crate) struct Danced {
    pub(crate) dance: GeneratedMotion,
    pub(crate) permit: Permit,
}

/// Generates a whole dance of `kind`.
pub(crate) async fn dance(
    metrics: &SharedMetrics,
    work: Work,
    permit: Permit,
    kind: &'static str,
) -> Result<Danced, ServerError> {
    let Work {
        engine,
        audio,
        options,
        watch,
    } = work;
    let measured = Arc::clone(metrics);
    run(metrics, &watch, move |watch| {
        let mut dance = engine.generate(audio, &options, &watch.cancel, Arc::clone(watch) as _)?;
        dance.timings.queue += permit.waited;
        measured.danced(kind, dance.codes.upper.len(), &dance.timings);
        Ok(Danced { dance, permit })
    })
    .await
}

/// Generates a dance that `listener` hears; the right to work is given back at its end.
pub(crate) async fn stream(
    metrics: &SharedMetrics,
    work: Work,
    permit: Permit,
    listener: Arc<dyn Listener>,
) -> Result<Ending, ServerError> {
    let Work {
        engine,
        audio,
        options,
        watch,
    } = work;
    let measured = Arc::clone(metrics);
    run(metrics, &watch, move |watch| {
        let mut ending = engine.stream(audio, &options, &watch.cancel, listener)?;
        ending.timings.queue += permit.waited;
        measured.danced("stream", ending.codes.upper.len(), &ending.timings);
        permit.complete();
        Ok(ending)
    })
    .await
}

/// Writes a dance as asked for.
pub(crate) async fn write(
    metrics: &SharedMetrics,
    watch: &Arc<Watch>,
    dance: Arc<GeneratedMotion>,
    options: RequestOptions,
    format: OutputFormat,
) -> Result<Vec<u8>, ServerError> {
    let measured = Arc::clone(metrics);
    run(metrics, watch, move |watch| {
        watch.enter(Phase::Write);
        let started = std::time::Instant::now();
        let span = tracing::info_span!("stage", otel.name = "write");
        let body = span.in_scope(|| options.write(&dance, format))?;
        measured.stage("write", started.elapsed());
        Ok(body)
    })
    .await
}

/// Runs with `watch` on a blocking thread. What it holds stays held until it has really ended, whether or not
/// somebody still waits.
async fn run<T: Send + 'static>(
    metrics: &SharedMetrics,
    watch: &Arc<Watch>,
    work: impl FnOnce(&Arc<Watch>) -> Result<T, ServerError> + Send + 'static,
) -> Result<T, ServerError> {
    let inner = Arc::clone(watch);
    let work = move || {
        // Also when the work panics.
        let _end = EndOnDrop(&inner);
        if !inner.begin() {
            return Err(crate::engine::EngineError::Cancelled.into());
        }
        work(&inner)
    };
    let result = blocking(metrics, || watch.phase().name(), work).await;
    if let Err(ServerError::Dance(Error::Audio(AudioError::DecoderPanic { .. }))) = &result {
        metrics.panicked("decode");
    }
    result
}

/// Runs on a blocking thread, in this request's span. A panic is counted as one of `place`, and costs this
/// request alone.
pub(crate) async fn blocking<T: Send + 'static>(
    metrics: &SharedMetrics,
    place: impl FnOnce() -> &'static str,
    work: impl FnOnce() -> Result<T, ServerError> + Send + 'static,
) -> Result<T, ServerError> {
    let span = Span::current();
    let ended = tokio::task::spawn_blocking(move || span.in_scope(work)).await;
    ended.unwrap_or_else(|failed| {
        metrics.panicked(place());
        Err(ServerError::Internal(match failed.try_into_panic() {
            Ok(panic) => format!("panic: {}", panic_text(panic.as_ref())),
            Err(failed) => failed.to_string(),
        }))
    })
}

struct EndOnDrop<'a>(&'a Watch);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}
