//! `POST /jobs`: an order is accepted once its song and itself are stored.

use std::sync::Arc;

use axum::{
    Json,
    extract::{Extension, Request, State},
    http::{HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use bailando_jobs::{Inserted, JobRecord, NewJob, now};
use tokio::sync::oneshot;
use tokio_util::task::task_tracker::TaskTrackerToken;
use uuid::Uuid;

use super::last_words;
use crate::{
    formats::{MotionSize, stored_bytes},
    server::{
        error::ServerError,
        intake::{self, Order, Purpose},
        jobs::{
            order::{Prepared, StoredOrder, from_text, to_text},
            service::Jobs,
            song::SongWriter,
            status::JobStatus,
        },
        layers::{client::Client, envelope::request_id},
        options::RequestOptions,
        resources::UploadReservation,
        response::documented::NewJobErrors,
        state::SharedState,
        upload::body::IncomingBody,
        workers,
    },
};

/// Says that the job was ordered before, with the same `Idempotency-Key`.
const REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");

/// Orders a dance that is fetched later.
///
/// The same input as `POST /generate`, and options of the job itself. The answer comes once the
/// song and the order are stored: from then on the job is done even if the server dies meanwhile.
/// Jobs run beside other requests, on half of the places to work in (at least one).
#[utoipa::path(
    post,
    path = "/jobs",
    operation_id = "create_job",
    tag = "jobs",
    params(
        RequestOptions,
        ("priority" = Option<i64>, Query,
            description = "Your jobs of a higher priority begin first, -100 to 100. Default: 0."),
        ("expires_s" = Option<f64>, Query,
            description = "Seconds after which the job fails if it has not begun, up to a year. \
                Default: never."),
        ("callback_url" = Option<String>, Query,
            description = "Where the end of the job is told: a POST of `type` and `data`, a \
                JobStatus, signed as Standard Webhooks says. The server's settings say which hosts \
                it calls. Default: nowhere."),
        ("idempotency-key" = Option<String>, Header,
            description = "The caller's name for this request, 1 to 255 visible characters: sent \
                again with the same song and options, it gives the same job."),
    ),
    responses(
        (
            status = 202,
            description = "The job is accepted, or was before with the same key.",
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
    let accepted = state.in_time(async {
        let mut order = intake::receive(&state, Purpose::Job, parts, body).await?;
        let accepted = accept(&state, client, id, &mut order).await;
        order.waiting.answered();
        accepted
    });
    let (job, replayed) = accepted.await?;
    workers::start(&state);
    state.jobs.wake.notify_one();
    let location = HeaderValue::try_from(format!("/jobs/{}", job.id))
        .map_err(|error| ServerError::Internal(error.to_string()))?;
    let status = JobStatus::of(&state.jobs, &job)?;
    if !replayed {
        keep_alive(&state, &job, under_way);
    }
    let mut response =
        (StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(status)).into_response();
    if replayed {
        response.headers_mut().insert(REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// Stores an order; the job, and whether it was known before.
async fn accept(
    state: &SharedState,
    client: Client,
    request_id: String,
    order: &mut Order,
) -> Result<(JobRecord, bool), ServerError> {
    let jobs = &state.jobs;
    let owner = jobs.owners().name(client);
    let model = order.engine.model_sha256();
    #[expect(clippy::expect_used, reason = "intake makes one for every job")]
    let song = order.song.take().expect("a job has a song, an empty one too");
    let prepared = {
        let (options, hash) = (order.options.clone(), song.hash());
        let (format, model) = (order.shape.format, model.to_owned());
        // Those of the longest dance, and a second more.
        let seconds = state.limits.max_audio_seconds + 1.0;
        let codes = (seconds * order.engine.manifest().codes_per_second()) as usize;
        let prepare = move || Ok(StoredOrder::prepare(&options, format, hash, &model, codes));
        crate::server::blocking::blocking(&state.metrics, "order", prepare).await?
    };
    if let Some(key) = &order.job.idempotency_key
        && let Some(known) = jobs.table.find_idempotent(&owner, key).await?
    {
        return Ok((same(known, &prepared)?, true));
    }
    let id = song.id();
    let result = known_result(jobs, &prepared, id).await;
    // The song of a dance that is there already is not kept.
    let song = result.is_none().then_some(song);
    let job = NewJob {
        id,
        request_id,
        priority: order.job.priority.unwrap_or(0),
        expires_at: order.job.expires_s.map(|wait| now().saturating_add((wait * 1e3) as i64)),
        model: model.to_owned(),
        content_key: prepared.content_key.clone(),
        idempotency_key: order.job.idempotency_key.clone(),
        order_bytes: i64::try_from(song.as_ref().map_or(0, SongWriter::bytes)).unwrap_or(i64::MAX),
        expected_bytes: expected_bytes(state, order, song.as_ref().map_or(0, SongWriter::bytes)),
        result,
        callback_url: order.job.callback_url.clone(),
        ..NewJob::new(&owner, &to_text(&prepared.order)?)
    };
    match keep(jobs, job, song, order.upload.take()).await? {
        Inserted::Known(known) => Ok((same(*known, &prepared)?, true)),
        Inserted::New => {
            let gone = || ServerError::NoJob { id: id.to_string() };
            Ok((jobs.table.find(id).await?.ok_or_else(gone)?, false))
        }
    }
}

/// Keeps a job and its song, in a task of its own: where its client hangs up meanwhile, what was
/// written is deleted, and `held` has its bytes as long as it is written.
async fn keep(
    jobs: &Arc<Jobs>,
    job: NewJob,
    song: Option<SongWriter>,
    held: Option<UploadReservation>,
) -> Result<Inserted, ServerError> {
    let jobs = Arc::clone(jobs);
    let (answer, kept) = oneshot::channel();
    tokio::spawn(async move {
        let folder = Jobs::folder(job.id);
        let written = match song {
            Some(song) => song.keep().await,
            None => Ok(()),
        };
        // A row without its song would be a job that cannot be done.
        let kept = match written {
            Ok(()) if answer.is_closed() => Ok(None),
            Ok(()) => jobs.keep(job).await.map(Some),
            Err(error) => Err(error.into()),
        };
        drop(held);
        let is_kept = matches!(kept, Ok(Some(Inserted::New)));
        // The answer comes before the clean-up, which can take long where the store does not
        // answer. A client that has left does not undo its order.
        drop(answer.send(kept));
        if !is_kept {
            // Nobody will ask for it; what is left is swept.
            drop(jobs.files.delete_below(&folder).await);
        }
    });
    match kept.await {
        Ok(kept) => kept?.ok_or_else(|| ServerError::Internal("an order was given up".to_owned())),
        Err(_) => Err(ServerError::Internal("an order was not kept".to_owned())),
    }
}

/// Assumed bit rate of a song, where the order does not say a length: 128 kbit/s, in bytes a
/// second. A larger result is kept where there is room for it.
const SONG_BYTES_A_SECOND: u64 = 16_000;

/// Bytes that the result of an order takes: as long as the order says, else as its song seems.
fn expected_bytes(state: &SharedState, order: &Order, song_bytes: u64) -> i64 {
    let (format, manifest) = (order.shape.format, order.engine.manifest());
    let fps = order.options.generation(format).fps;
    let most = order.most_seconds(&state.limits, false);
    let seconds = match order.said_seconds() {
        Some(_) => most,
        None => most.min(song_bytes.div_ceil(SONG_BYTES_A_SECOND)),
    };
    // However long songs may be, what follows is a number.
    let frames = seconds.saturating_mul(fps.into()).min(u32::MAX.into()) as usize;
    let size = MotionSize { frames, joints: manifest.skeleton.joints.len(), fps };
    let file = match state.jobs.durable {
        true => format.most_bytes(size, &order.options.writing()),
        false => 0,
    };
    i64::try_from(stored_bytes(size).saturating_add(file)).unwrap_or(i64::MAX)
}

/// A copy of the result of the same order, where there is one.
async fn known_result(jobs: &Jobs, prepared: &Prepared, id: Uuid) -> Option<(String, i64)> {
    if !prepared.repeats {
        return None;
    }
    let since = jobs.finished_since();
    let known = jobs.table.find_result(&prepared.content_key, since).await.ok()??;
    let text = known.result?;
    let copied = jobs.files.copy_below(&Jobs::folder(known.id), &Jobs::folder(id), "song").await;
    // Without it the dance is made again.
    copied.ok().filter(|files| *files > 0).map(|_| (text, known.result_bytes))
}

/// The job of an idempotency key, if it was ordered by the same request.
fn same(known: JobRecord, prepared: &Prepared) -> Result<JobRecord, ServerError> {
    let order: StoredOrder = from_text(known.id, &known.order)?;
    match order.fingerprint == prepared.order.fingerprint {
        true => Ok(known),
        false => Err(ServerError::KeyReused),
    }
}

/// Where jobs end with the process, it ends only when the job has, and its result was fetched or
/// nobody asks for it any more.
fn keep_alive(state: &SharedState, job: &JobRecord, under_way: TaskTrackerToken) {
    if !state.jobs.durable {
        tokio::spawn(last_words::wait(Arc::clone(state), job.id, under_way));
    }
}
