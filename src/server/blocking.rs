//! Blocking parts of the work, off the async threads.

use std::{any::Any, sync::Arc};

use tracing::Span;

use super::{
    error::ServerError,
    metrics::SharedMetrics,
    tracker::{Phase, Work},
};

/// Writes a dance. `work` is held until that has ended.
pub(crate) async fn write<T: Send + 'static>(
    metrics: &SharedMetrics,
    work: Option<Arc<Work>>,
    write: impl FnOnce() -> Result<T, ServerError> + Send + 'static,
) -> Result<T, ServerError> {
    let measured = Arc::clone(metrics);
    let write = move || {
        if let Some(work) = &work {
            work.tracker().enter(Phase::Write);
        }
        let started = std::time::Instant::now();
        let span = tracing::info_span!("stage", otel.name = "write");
        let written = span.in_scope(write)?;
        measured.stage("write", started.elapsed());
        Ok(written)
    };
    blocking(metrics, Phase::Write.name(), write).await
}

/// Runs on a blocking thread, in this request's span. A panic is counted as one of `place`, and
/// costs this request alone.
pub(crate) async fn blocking<T: Send + 'static>(
    metrics: &SharedMetrics,
    place: &'static str,
    work: impl FnOnce() -> Result<T, ServerError> + Send + 'static,
) -> Result<T, ServerError> {
    let span = Span::current();
    let ended = tokio::task::spawn_blocking(move || span.in_scope(work)).await;
    ended.unwrap_or_else(|failed| {
        metrics.panicked(place);
        Err(ServerError::Internal(match failed.try_into_panic() {
            Ok(panic) => format!("panic: {}", panic_text(panic.as_ref())),
            Err(failed) => failed.to_string(),
        }))
    })
}

/// Returns the message of a panic, as far as it has one.
pub(crate) fn panic_text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}
