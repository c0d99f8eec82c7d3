//! The engine's work on a request.

use std::{sync::Arc, time::Duration};

use bytes::Bytes;

use super::{
    blocking,
    config::Limits,
    error::ServerError,
    intake::Order,
    metrics::SharedMetrics,
    resources::{Permit, Stay},
    state::SharedState,
    tracker::{Held, RequestTracker, Work},
};
use crate::{
    audio::AudioError,
    engine::{EngineError, Generation, GenerationOptions, GenerationOutput, GenerationRequest},
    formats::GeneratedMotion,
    options::Take,
};

impl Order {
    /// Waits for a worker. A song whose length nobody says is short until it proves long.
    pub(crate) async fn admit(
        &self,
        state: &SharedState,
        stay: Stay,
    ) -> Result<Permit, ServerError> {
        let said = self.said_seconds();
        let is_long = said.is_some_and(|seconds| seconds > self.short_seconds(&state.limits));
        let stay = if is_long { Stay::Long } else { stay };
        state.resources.admission.admit(self.client, stay).await
    }

    /// Waits for a share of the audio seconds, and begins the work; the song goes with the request
    /// to the engine. How long it really is, is known once it is decoded. The worker for short
    /// requests refuses a longer one, which then begins again with another.
    pub(crate) async fn begin(
        &mut self,
        state: &SharedState,
        permit: Permit,
    ) -> Result<(GenerationRequest, Arc<Work>), ServerError> {
        let is_express = permit.is_express();
        let most = self.most_seconds(&state.limits, is_express);
        let held = Some(state.resources.audio.reserve(most).await);
        let options = self.options.generation(self.shape.format);
        // Who may have to begin again keeps the song.
        let (audio, upload) = match is_express || self.options.bars_wanted().is_some() {
            true => (self.audio.clone(), None),
            false => (std::mem::take(&mut self.audio), self.upload.take()),
        };
        let work = Work::begin(&self.tracker, Held { upload, audio: held, permit: Some(permit) });
        let short = is_express.then(|| self.short_seconds(&state.limits));
        Ok((self.request(audio, options, short, &work), work))
    }

    /// A request to the engine; `short` is the longest song in seconds that it accepts.
    fn request(
        &self,
        audio: Bytes,
        options: GenerationOptions,
        short: Option<f64>,
        work: &Arc<Work>,
    ) -> GenerationRequest {
        let request = match audio.is_empty() {
            true => GenerationRequest::codes(options),
            false => GenerationRequest::audio(audio, options),
        };
        let request = request.owned_by(self.client.number());
        let request = request.with_progress(Arc::clone(work) as _);
        short.into_iter().fold(request, GenerationRequest::within)
    }

    /// The longest dance that counts as short.
    fn short_seconds(&self, limits: &Limits) -> f64 {
        limits.short_seconds / self.options.most_candidates() as f64
    }

    /// The most whole seconds that the dance can take, in the worker for short requests or another.
    pub(crate) fn most_seconds(&self, limits: &Limits, is_express: bool) -> u64 {
        let longest = match is_express {
            true => self.short_seconds(limits).min(limits.max_audio_seconds),
            false => limits.max_audio_seconds,
        };
        let asked = self.said_seconds().unwrap_or(longest);
        asked.min(longest).ceil() as u64
    }

    /// The longest dance that the request says, by its options or by codes without a song.
    pub(crate) fn said_seconds(&self) -> Option<f64> {
        let asked = self.options.longest_seconds();
        let given = self.options.given_codes().filter(|_| self.audio.is_empty());
        let given = given.map(|codes| codes as f64 / self.engine.manifest().codes_per_second());
        match (asked, given) {
            (Some(asked), Some(given)) => Some(asked.min(given)),
            (asked, given) => asked.or(given),
        }
    }
}

/// Waits for a worker, and generates a whole dance of `kind`.
pub(crate) async fn dance_in_turn(
    state: &SharedState,
    order: &mut Order,
    kind: &'static str,
) -> Result<(GeneratedMotion, Arc<Work>), ServerError> {
    let permit = order.admit(state, Stay::Short).await?;
    let is_express = permit.is_express();
    match dance(state, order, permit, kind).await {
        Err(error) if is_express && error.is_too_long() => {
            let permit = order.admit(state, Stay::Long).await?;
            dance(state, order, permit, kind).await
        }
        other => other,
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
    let short = permit.is_express().then(|| order.short_seconds(&state.limits));
    let (request, work) = order.begin(state, permit).await?;
    let danced = takes(state, order, request, (waited, short, kind), &work).await;
    if danced.is_err() {
        drop(work.end());
    }
    Ok((danced?, work))
}

/// Generates as many dances as the options want, one after another.
async fn takes(
    state: &SharedState,
    order: &Order,
    mut request: GenerationRequest,
    (mut waited, short, kind): (Duration, Option<f64>, &'static str),
    work: &Arc<Work>,
) -> Result<GeneratedMotion, ServerError> {
    let metrics = &state.metrics;
    let mut takes = order.options.takes();
    loop {
        let generation = order.engine.submit(request);
        let output = finished(metrics, generation, &order.tracker, waited, kind).await?;
        let dance = output.into_motion(order.engine.manifest());
        if order.options.bars_wanted().is_none() {
            work.free_audio();
            return Ok(dance);
        }
        let compare = move || takes.push(dance).map_err(ServerError::from);
        let seed = match blocking::blocking(metrics, "loop", compare).await? {
            Take::Done(dance) => {
                work.free_audio();
                return Ok(dance);
            }
            Take::Another(rest, seed) => {
                takes = rest;
                seed
            }
        };
        waited = Duration::ZERO;
        let options = order.options.generation(order.shape.format);
        let options = GenerationOptions { seed: Some(seed), ..options };
        request = order.request(order.audio.clone(), options, short, work);
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
