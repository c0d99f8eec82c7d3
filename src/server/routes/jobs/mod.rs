//! `/jobs`: dances that are asked for now and fetched later.

pub(crate) mod events;
mod life;
mod status;

use std::sync::Arc;

use axum::{
    Json,
    extract::{Extension, Path, Request, State, rejection::PathRejection},
    http::{HeaderMap, HeaderValue, StatusCode, Uri, header},
    response::{IntoResponse, Response},
};
use tracing::Instrument;

use self::status::{JobStatus, find};
use crate::server::{
    error::{Report, ServerError},
    intake::{self, Purpose},
    jobs::{Job, JobState},
    layers::{client::Client, envelope::request_id},
    options::{OutputOptions, RequestOptions},
    response::{
        documented::{JobErrors, JobResultErrors, MotionResponse, NewJobErrors},
        encoding::Encoding,
        negotiate::{self, Shape},
    },
    routes::generate::Rendered,
    state::SharedState,
    upload::body::IncomingBody,
};

/// Orders a dance that is fetched later.
///
/// The same input as `POST /generate`. The answer comes as soon as the song is here; jobs run
/// beside other requests, on half of the places to work in (at least one).
#[utoipa::path(
    post,
    path = "/jobs",
    operation_id = "create_job",
    tag = "jobs",
    params(RequestOptions),
    responses(
        (
            status = 202,
            description = "The job is accepted.",
            body = JobStatus,
            headers(
                ("location" = String, description = "Where the job is asked about."),
                ("x-request-id" = String, description = "The request's id."),
            )
        ),
        NewJobErrors,
    )
)]
pub(crate) async fn create(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    request: Request,
) -> Result<Response, ServerError> {
    let id = request_id(&request).to_owned();
    let (parts, body) = request.into_parts();
    let body = IncomingBody::new(body);
    let under_way = state.lifecycle.enter().ok_or_else(|| state.draining())?;
    let order = intake::receive(&state, Purpose::Job, parts, body);
    let order = state.in_time(order).await?;
    let job = Job::new(client, id, Arc::clone(&order.tracker), Arc::clone(&state.metrics));
    if let Err(full) = state.jobs.put(Arc::clone(&job)) {
        order.waiting.answered();
        return Err(full);
    }
    let location = format!("/jobs/{}", job.id);
    let status = JobStatus::of(&job);
    let span = tracing::info_span!("job", id = %job.id);
    tokio::spawn(life::live(Arc::clone(&state), order, job, under_way).instrument(span));
    let location = HeaderValue::try_from(location)
        .map_err(|error| ServerError::Internal(error.to_string()))?;
    let headers = [(header::LOCATION, location)];
    Ok((StatusCode::ACCEPTED, headers, Json(status)).into_response())
}

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
    Ok(Json(JobStatus::of(&*find(&state, client, id)?)))
}

/// Gives a job's dance, in any format.
///
/// The options that say how a dance is written may be given again. Without `format` the Accept
/// header chooses; where it has no preference, the dance comes as it was ordered. A job that failed
/// is answered as `POST /generate` would have been.
#[utoipa::path(
    get,
    path = "/jobs/{id}/result",
    operation_id = "get_job_result",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job's id."),
        OutputOptions,
    ),
    responses(
        MotionResponse,
        JobResultErrors,
    )
)]
pub(crate) async fn result(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    id: Result<Path<String>, PathRejection>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ServerError> {
    let job = find(&state, client, id)?;
    let asked = RequestOptions::from_query(&uri)?;
    let finished = match job.ask() {
        JobState::Done(finished) => finished,
        JobState::Failed(report) => return Ok(failed(&job, report)),
        unfinished => {
            return Err(ServerError::JobNotDone {
                id: job.id.to_string(),
                state: unfinished.name(),
            });
        }
    };
    let options = finished.options.written_as(&asked)?;
    let encoding = Encoding::preferred(&headers);
    let format = match asked.format {
        Some(format) => format,
        None => negotiate::dance(&headers, finished.format)?,
    };
    let under_way = state.lifecycle.go_on();
    let rendered = state.in_time(async {
        let (dance, held) = (&finished.dance, (&state.resources, &state.metrics));
        let shape = Shape { format, encoding, lines: false };
        let written = finished.answers.get(held, client, dance, &options, shape).await?;
        Ok(Rendered::new(dance, written, format))
    });
    let rendered = rendered.await?;
    Ok(rendered.respond(&state, under_way, move || job.fetched.cancel()))
}

fn failed(job: &Job, report: Report) -> Response {
    job.fetched.cancel();
    report.into_response()
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
    let job = find(&state, client, id)?;
    state.jobs.remove(job.id);
    Ok(StatusCode::NO_CONTENT)
}
