//! How far a job is, and whose it is.

use std::sync::Arc;

use axum::extract::{Path, rejection::PathRejection};
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

use crate::server::{
    error::{ErrorBody, ServerError},
    jobs::{Job, JobState},
    layers::client::Client,
    options::shorten,
    state::SharedState,
};

/// How far a job is.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct JobStatus {
    /// The job's id.
    #[schema(example = "67e55044-10b1-426f-9247-bb680e5fe0c8")]
    id: String,
    /// `queued`, `running`, `done` or `failed`.
    #[schema(example = "running")]
    pub(super) state: &'static str,
    /// What is being done while it runs: `decode`, `features`, `inference` or `motion`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    stage: Option<&'static str>,
    /// Pairs of pose codes that exist.
    codes_done: usize,
    /// Pairs of pose codes of the whole dance; 0 while that is not known.
    codes_total: usize,
    /// Where the result is, once there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    result: Option<String>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    error: Option<ErrorBody>,
}

impl JobStatus {
    pub(super) fn of(job: &Job) -> Self {
        let state = job.ask();
        let (codes_done, codes_total) = job.tracker.codes_done();
        Self {
            id: job.id.to_string(),
            state: state.name(),
            stage: matches!(state, JobState::Running).then(|| job.tracker.phase().name()),
            codes_done,
            codes_total,
            result: matches!(state, JobState::Done(_)).then(|| format!("/jobs/{}/result", job.id)),
            error: match state {
                JobState::Failed(report) => Some(report.body(&job.request_id)),
                _ => None,
            },
        }
    }
}

/// A job of this client: one that was ordered with a key is found with that key only.
pub(super) fn find(
    state: &SharedState,
    client: Client,
    id: Result<Path<String>, PathRejection>,
) -> Result<Arc<Job>, ServerError> {
    let Path(id) = id.map_err(|_| ServerError::NoJob { id: "of this name".to_owned() })?;
    let none = || ServerError::NoJob { id: shorten(&id) };
    let job = Uuid::try_parse(&id).ok().and_then(|id| state.jobs.get(id)).ok_or_else(none)?;
    match job.owner {
        Client::Key(_) if job.owner != client => Err(none()),
        _ => Ok(job),
    }
}
