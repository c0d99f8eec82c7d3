//! One worker: takes a job, dances, stores the result, takes the next.

use std::{panic::AssertUnwindSafe, sync::Arc, time::Duration};

use axum::http::StatusCode;
use bailando_jobs::{Claim, JobsError, LONGEST_WAIT, Lease, PutBack};
use futures_util::FutureExt;
use tokio::time::{Instant, sleep, timeout};
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::{
    lease,
    store::{self, Kept},
};
use crate::{
    formats::{GeneratedMotion, OutputFormat},
    server::{
        error::ServerError,
        intake::Order,
        jobs::{
            order::{StoredError, StoredOrder, from_text, to_text},
            service::{BeingDone, Jobs, Running},
        },
        options::RequestOptions,
        resources::{Permit, Stay},
        response::{encoding::Encoding, negotiate::Shape},
        state::SharedState,
        tracker::{Phase, RequestTracker, Waiting},
        work,
    },
};

/// Time between two looks for jobs that came by other replicas, or whose wait is over.
const LOOK_AGAIN: Duration = Duration::from_millis(500);
/// Wait before a job is tried again after a first fault; it doubles with each.
const BACKOFF: Duration = Duration::from_secs(1);

/// Works on jobs until the process stops. `share` is how many jobs of one owner are in work here
/// at most.
pub(super) async fn work(state: SharedState, share: usize) {
    let stopped = stopped(&state);
    tokio::pin!(stopped);
    loop {
        if stopped.as_mut().now_or_never().is_some() {
            return;
        }
        // To its end: a job that was taken and is not worked on waits until its lease is over.
        match take(&state, share).await {
            Ok(Some(taken)) => {
                let span = tracing::info_span!("job", id = %taken.lease.job.id);
                let run = AssertUnwindSafe(run(&state, taken)).catch_unwind().instrument(span);
                if run.await.is_err() {
                    state.metrics.panicked("job");
                }
                continue;
            }
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "no job can be taken"),
        }
        tokio::select! {
            () = &mut stopped => return,
            () = state.jobs.wake.notified() => {}
            () = sleep(LOOK_AGAIN) => {}
        }
    }
}

/// When a worker takes no more jobs. Jobs that would end with the process are worked off before.
async fn stopped(state: &SharedState) {
    state.lifecycle.draining().await;
    if !state.jobs.durable {
        tokio::select! {
            () = state.lifecycle.idle() => {}
            () = state.lifecycle.aborted() => {}
        }
    }
}

/// A job that is worked on here.
struct Taken {
    lease: Lease,
    tracker: Arc<RequestTracker>,
    deleted: CancellationToken,
    here: BeingDone,
}

async fn take(state: &SharedState, share: usize) -> Result<Option<Taken>, JobsError> {
    let Ok(engine) = state.engine() else { return Ok(None) };
    let limits = &state.limits;
    // One after another, so that no owner is given more than its share: what waits for its turn
    // here, another replica could do.
    let _turn = state.jobs.taking.lock().await;
    let full = state.jobs.full_owners(share);
    let claim = Claim {
        model: engine.model_sha256(),
        lease: limits.job_lease.0,
        most_starts: i64::try_from(limits.job_starts.get()).unwrap_or(i64::MAX),
        full: &full,
    };
    let claimed = state.jobs.table.claim(&claim).await?;
    Ok(claimed.map(|lease| Taken::begin(state, lease)))
}

impl Taken {
    fn begin(state: &SharedState, lease: Lease) -> Self {
        let tracker = RequestTracker::new(Arc::clone(&state.metrics));
        tracker.enter(Phase::Queue);
        let running = Running {
            owner: lease.job.owner.clone(),
            tracker: Arc::clone(&tracker),
            deleted: CancellationToken::new(),
        };
        let deleted = running.deleted.clone();
        let here = state.jobs.begin(lease.job.id, running);
        Self { lease, tracker, deleted, here }
    }
}

async fn run(state: &SharedState, taken: Taken) {
    let _under_way = match state.jobs.durable {
        true => state.lifecycle.go_on_with_job(),
        false => state.lifecycle.go_on(),
    };
    let Taken { lease, tracker, deleted, here: _here } = taken;
    let worked = async {
        let made = make(state, &lease, &tracker).await;
        settle(state, &lease, &tracker, made).await;
    };
    tokio::select! {
        biased;
        // Dropping the work stops it.
        () = deleted.cancelled() => {}
        () = worked => {}
        () = lease::until_lost(state, &lease, &tracker) => {}
        () = state.lifecycle.aborted() => {
            // Another process begins it at once, or this one's next life.
            drop(state.jobs.table.put_back(&lease, PutBack::Release).await);
        }
    }
}

/// Makes the dance of a job, and stores it.
async fn make(
    state: &SharedState,
    lease: &Lease,
    tracker: &Arc<RequestTracker>,
) -> Result<Kept, ServerError> {
    let order: StoredOrder = from_text(lease.job.id, &lease.job.order)?;
    let (options, format) = order.read()?;
    let dance = dance(state, lease, tracker, &options, format).await?;
    tracker.enter(Phase::Write);
    store::store(state, lease, dance, options, format).await
}

async fn dance(
    state: &SharedState,
    lease: &Lease,
    tracker: &Arc<RequestTracker>,
    options: &RequestOptions,
    format: OutputFormat,
) -> Result<GeneratedMotion, ServerError> {
    let engine = Arc::clone(state.engine()?);
    engine.check(&options.generation(format))?;
    let client = state.jobs.owners().client(&lease.job.owner);
    // The phase is `queue` from here on: reading the song counts as waiting.
    let asked = Instant::now();
    let audio = state.jobs.files.read_whole(&Jobs::song(lease.job.id)).await?;
    let mut permit = state.resources.admission.admit_unqueued(client, Stay::Long).await;
    permit.waited = asked.elapsed();
    let mut order = Order {
        engine,
        client,
        audio,
        song: None,
        options: options.clone(),
        rig: None,
        shape: Shape { format, encoding: Encoding::Identity, lines: false },
        upload: None,
        job: Default::default(),
        tracker: Arc::clone(tracker),
        waiting: Waiting::of(tracker),
    };
    let limit = state.limits.job_timeout;
    let made = timeout(limit.0, work::dance(state, &mut order, permit, "job")).await;
    let retry_after = state.resources.retry_after();
    let made = made.unwrap_or(Err(ServerError::JobTimeout { limit, retry_after }));
    order.waiting.answered();
    let (dance, work) = made?;
    work.end().into_iter().for_each(Permit::complete);
    Ok(dance)
}

/// Writes down what has become of a job. While the database does not answer, it is tried again; if
/// that takes longer than the lease, another worker does the job once more.
async fn settle(
    state: &SharedState,
    lease: &Lease,
    tracker: &RequestTracker,
    made: Result<Kept, ServerError>,
) {
    let table = &state.jobs.table;
    let ended = match made {
        Ok(kept) => Ok(kept),
        Err(error) => Err((Remedy::of(&error, lease, state), error)),
    };
    loop {
        let settled = match &ended {
            Ok(Kept { text, bytes }) => {
                table.done(lease, text.clone(), *bytes, &lease::reached(tracker)).await
            }
            Err((Remedy::PutBack(why), _)) => table.put_back(lease, *why).await,
            Err((Remedy::Fail, error)) => fail(state, lease, error).await,
        };
        match settled {
            Ok(_) => break,
            Err(error) => tracing::warn!(%error, "the end of a job cannot be written down yet"),
        }
        sleep(LOOK_AGAIN).await;
    }
    match &ended {
        // It is deleted with the job at the latest.
        Ok(_) | Err((Remedy::Fail, _)) => {
            drop(state.jobs.files.delete(&Jobs::song(lease.job.id)).await);
        }
        // A model that has stopped stops the process soon; nothing is to be taken meanwhile.
        Err((Remedy::PutBack(PutBack::Release), _)) => sleep(BACKOFF).await,
        Err((Remedy::PutBack(_), error)) => {
            tracing::warn!(%error, "a job is put back after a fault");
            state.metrics.job_retries.inc();
        }
    }
}

async fn fail(state: &SharedState, lease: &Lease, error: &ServerError) -> Result<bool, JobsError> {
    let report = error.report();
    let text = to_text(&StoredError::new(&report)).unwrap_or_default();
    let failed = state.jobs.table.fail(lease, text).await?;
    state.metrics.rejected(&report.error_type);
    Ok(failed)
}

/// What is done about a job that could not be made.
enum Remedy {
    /// The process is at its end, or the service was at fault and may not be the next time.
    PutBack(PutBack),
    /// The song, an option or the time is at fault, or the service too often.
    Fail,
}

impl Remedy {
    fn of(error: &ServerError, lease: &Lease, state: &SharedState) -> Self {
        if matches!(
            error,
            ServerError::ModelStopped | ServerError::Draining { .. } | ServerError::Loading { .. }
        ) {
            return Self::PutBack(PutBack::Release);
        }
        let passes = match error.status() {
            StatusCode::INTERNAL_SERVER_ERROR | StatusCode::TOO_MANY_REQUESTS => true,
            StatusCode::SERVICE_UNAVAILABLE => !matches!(error, ServerError::JobTimeout { .. }),
            _ => false,
        };
        let faults = usize::try_from(lease.job.faults).unwrap_or(usize::MAX);
        let doublings = u32::try_from(faults).unwrap_or(u32::MAX).min(16);
        let wait = (BACKOFF * 2_u32.pow(doublings)).min(LONGEST_WAIT);
        // As long as a result would be kept.
        let young = lease.job.created_at >= state.jobs.finished_since();
        if matches!(error, ServerError::JobStore { .. }) && young {
            return Self::PutBack(PutBack::Postpone(wait));
        }
        let starts = usize::try_from(lease.job.starts).unwrap_or(usize::MAX);
        let too_often = faults.saturating_add(1) >= state.limits.job_attempts.get()
            || starts >= state.limits.job_starts.get();
        match passes && !too_often {
            true => Self::PutBack(PutBack::Retry(wait)),
            false => Self::Fail,
        }
    }
}
