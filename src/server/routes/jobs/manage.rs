//! Jobs are asked about, listed and deleted.

use axum::{
    Json,
    extract::{
        Extension, Path, Query, State,
        rejection::{PathRejection, QueryRejection},
    },
    http::StatusCode,
};
use bailando_jobs::{Listing, State as JobState};
use serde::Deserialize;
use utoipa::IntoParams;
use uuid::Uuid;

use super::find::find;
use crate::server::{
    error::ServerError,
    jobs::status::{JobList, JobStatus},
    layers::client::Client,
    options::shorten,
    response::documented::{JobErrors, JobListErrors},
    state::SharedState,
};

/// Jobs of a page, unless a request says otherwise, and at most.
const PAGE: u32 = 100;
const LARGEST_PAGE: u32 = 1000;

/// Says how far a job is.
#[utoipa::path(
    get,
    path = "/jobs/{id}",
    operation_id = "get_job",
    tag = "jobs",
    params(("id" = String, Path, description = "The job's id.")),
    responses(
        (status = 200, description = "How far it is.", body = JobStatus),
        JobErrors,
    )
)]
pub(crate) async fn status(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<JobStatus>, ServerError> {
    let job = find(&state, client, id).await?;
    state.jobs.ask(job.id);
    Ok(Json(JobStatus::of(&state.jobs, &job)?))
}

/// Which jobs to list.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct ListOptions {
    /// Jobs in this state only: `queued`, `running`, `done` or `failed`.
    #[param(example = "done")]
    state: Option<String>,
    /// Jobs of a page, 1 to 1000. Default: 100.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// The page after this job: `next` of the page before.
    before: Option<String>,
}

/// Lists the caller's jobs, the latest first.
///
/// Those that were ordered with the same API key; without keys, from the same address.
#[utoipa::path(
    get,
    path = "/jobs",
    operation_id = "list_jobs",
    tag = "jobs",
    params(ListOptions),
    responses(
        (status = 200, description = "The jobs.", body = JobList),
        JobListErrors,
    )
)]
pub(crate) async fn list(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    options: Result<Query<ListOptions>, QueryRejection>,
) -> Result<Json<JobList>, ServerError> {
    let refuse = |name: &str, got: &str, accepted: &str| ServerError::Option {
        name: name.to_owned(),
        problem: format!("got {:?}, expected {accepted}", shorten(got)),
    };
    let Query(options) = options.map_err(|rejection| ServerError::Option {
        name: "query".to_owned(),
        problem: rejection.body_text(),
    })?;
    let wanted = match &options.state {
        None => None,
        Some(name) => Some(
            JobState::of(name)
                .ok_or_else(|| refuse("state", name, "one of queued, running, done, failed"))?,
        ),
    };
    let most = options.limit.unwrap_or(PAGE);
    if !(1..=LARGEST_PAGE).contains(&most) {
        return Err(refuse("limit", &most.to_string(), "a whole number from 1 to 1000"));
    }
    let before = match &options.before {
        None => None,
        Some(text) => {
            let place = text
                .split_once('.')
                .and_then(|(time, id)| Some((time.parse().ok()?, Uuid::try_parse(id).ok()?)));
            Some(place.ok_or_else(|| refuse("before", text, "the `next` of another page"))?)
        }
    };
    let jobs = &state.jobs;
    let listing = Listing {
        owner: jobs.owners().name(client),
        state: wanted,
        before,
        most,
        finished_since: jobs.finished_since(),
    };
    let listed = jobs.table.list(listing).await?;
    let full = listed.len() >= usize::try_from(most).unwrap_or(usize::MAX);
    let next = listed.last().filter(|_| full);
    Ok(Json(JobList {
        next: next.map(|job| format!("{}.{}", job.created_at, job.id)),
        // One that cannot be read is left out, and logged.
        jobs: listed.iter().filter_map(|job| JobStatus::of(jobs, job).ok()).collect(),
    }))
}

/// Stops a job, if it is not done, and forgets it.
#[utoipa::path(
    delete,
    path = "/jobs/{id}",
    operation_id = "delete_job",
    tag = "jobs",
    params(("id" = String, Path, description = "The job's id.")),
    responses(
        (status = 204, description = "There is no such job any more."),
        JobErrors,
    )
)]
pub(crate) async fn delete(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    id: Result<Path<String>, PathRejection>,
) -> Result<StatusCode, ServerError> {
    let job = find(&state, client, id).await?;
    state.jobs.forget(job.id).await?;
    Ok(StatusCode::NO_CONTENT)
}
