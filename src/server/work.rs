//! The engine's work on a request.

use std::{sync::Arc, time::Duration};

use super::{
    config::Limits,
    error::ServerError,
    intake::Order,
    metrics::SharedMetrics,
    resources::Permit,
    state::SharedState,
    tracker::{Held, RequestTracker, Work},
};
use crate::{
    audio::AudioError,
    engine::{EngineError, Generation, GenerationOutput, GenerationRequest},
    formats::GeneratedMotion,
};

impl Order {
    /// Waits for a share of the audio seconds, and begins the work; the song goes with the request
    /// to the engine. How long it really is, is known once it is decoded.
    pub(crate) async fn begin(
        &mut self,
        state: &SharedState,
        permit: Permit,
    ) -> Result<(GenerationRequest, Arc<Work>), ServerError> {
        let audio = state.resources.audio.reserve(self.most_seconds(&state.limits)).await;
        let held = Held { upload: self.upload.take(), audio: Some(audio), permit: Some(permit) };
        let work = Work::begin(&self.tracker, held);
        let audio = std::mem::take(&mut self.audio);
        let options = self.options.generation(self.shape.format);
        let request = GenerationRequest::audio(audio, options).owned_by(self.client.number());
        Ok((request.with_progress(Arc::clone(&work) as _), work))
    }

    /// The most whole seconds that the dance can take.
    pub(crate) fn most_seconds(&self, limits: &Limits) -> u64 {
        let longest = limits.max_audio_seconds;
        let asked = self.options.longest_seconds().unwrap_or(longest);
        asked.min(longest).ceil() as u64
    }
}

/// Generates a whole dance of `kind`. The permit stays with the work.
pub(crate) async fn dance(
    state: &SharedState,
    order: &mut Order,
    permit: Permit,
    kind: &'static str,
) -> Result<(GeneratedMotion, Arc<Work>), ServerError> {
    let waited = permit.waited;
    let (request, work) = order.begin(state, permit).await?;
    let generation = order.engine.submit(request);
    let metrics = &state.metrics;
    let output = finished(metrics, generation, &order.tracker, waited, kind).await;
    match output {
        Ok(output) => {
            work.free_audio();
            Ok((output.into_motion(order.engine.manifest()), work))
        }
        Err(error) => {
            drop(work.end());
            Err(error)
        }
    }
}

/// Waits for a generation of `kind`, which waited for a permit before, and counts it.
pub(crate) async fn finished(
    metrics: &SharedMetrics,
    generation: Generation,
    tracker: &RequestTracker,
    waited: Duration,
    kind: &'static str,
) -> Result<GenerationOutput, ServerError> {
    match generation.await {
        Ok(mut output) => {
            output.timings.queue += waited;
            metrics.danced(kind, output.codes.upper.len(), &output.timings);
            Ok(output)
        }
        Err(error) => {
            match &error {
                EngineError::Panicked { .. } => metrics.panicked(tracker.phase().name()),
                EngineError::Audio(AudioError::DecoderPanic { .. }) => metrics.panicked("decode"),
                _ => {}
            }
            Err(error.into())
        }
    }
}
