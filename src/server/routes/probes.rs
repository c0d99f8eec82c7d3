//! Probes and self-description: they never wait for anything and take no permit.

use std::time::Duration;

use axum::{
    Json,
    extract::State,
    http::header,
    response::{IntoResponse, Response},
};
use serde::Serialize;
use utoipa::ToSchema;

use crate::server::{
    error::ServerError, info::Info, layers::envelope::Held, response::documented::NotReady,
    state::SharedState,
};

/// Answer of the probes.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(crate) struct Status {
    #[schema(example = "ok")]
    status: &'static str,
}

/// Whether the process lives.
#[utoipa::path(
    get,
    path = "/health",
    operation_id = "get_health",
    tag = "probes",
    responses((status = 200, description = "The server lives.", body = Status))
)]
pub(crate) async fn health() -> Json<Status> {
    Json(Status { status: "ok" })
}

/// Whether requests are taken: the model is loaded and runs, and the server is not shutting down.
#[utoipa::path(
    get,
    path = "/ready",
    operation_id = "get_readiness",
    tag = "probes",
    responses(
        (status = 200, description = "Requests are accepted.", body = Status),
        NotReady,
    )
)]
pub(crate) async fn ready(State(state): State<SharedState>) -> Result<Json<Status>, ServerError> {
    if state.lifecycle.is_draining() {
        return Err(state.draining());
    }
    state.engine()?;
    Ok(Json(Status { status: "ready" }))
}

/// The model, what can be asked for, and every limit.
#[utoipa::path(
    get,
    path = "/info",
    operation_id = "get_info",
    tag = "probes",
    responses(
        (status = 200, description = "About this service.", body = Info),
        NotReady,
    )
)]
pub(crate) async fn info(State(state): State<SharedState>) -> Result<Json<Info>, ServerError> {
    Ok(Json(state.loaded()?.info.clone()))
}

/// Media type of what Prometheus reads.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// A scrape waits so long for the numbers of jobs.
const JOBS_COUNTED: Duration = Duration::from_millis(500);

/// What is counted, as Prometheus reads it.
#[utoipa::path(
    get,
    path = "/metrics",
    operation_id = "get_metrics",
    tag = "probes",
    responses((
        status = 200,
        description = "The metrics, in the OpenMetrics text format.",
        content((String = "application/openmetrics-text"))
    ))
)]
pub(crate) async fn metrics(State(state): State<SharedState>) -> Result<Response, ServerError> {
    // Of all replicas; where the table does not answer, as it was last known.
    let counted = tokio::time::timeout(JOBS_COUNTED, state.jobs.table.count()).await;
    for (of, jobs) in counted.ok().and_then(Result::ok).into_iter().flatten() {
        state.metrics.jobs(of.name(), jobs);
    }
    let text = state.metrics.shared_text();
    let text = text.map_err(|error| ServerError::Internal(error.to_string()))?;
    // Whoever else holds memory, this is answered.
    Ok((Held::Shared, [(header::CONTENT_TYPE, OPEN_METRICS)], text).into_response())
}
