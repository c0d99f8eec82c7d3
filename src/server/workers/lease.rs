//! Signs of life: of a worker, and of its work on a job.

use std::time::Duration;

use bailando_jobs::{Lease, Reached};
use tokio::time::{Instant, sleep, timeout};
use uuid::Uuid;

use crate::server::{state::SharedState, tracker::RequestTracker};

/// Longest time between two looks at a job: its progress is seen elsewhere that often.
const PROGRESS: Duration = Duration::from_secs(1);

/// Says that this worker and its model are here, until it stops.
pub(super) async fn say_alive(state: SharedState) {
    let worker = Uuid::new_v4();
    let stopping = state.lifecycle.stopping();
    while !stopping.is_cancelled() {
        if let Ok(engine) = state.engine() {
            // The next time tells as well.
            drop(state.jobs.table.alive(worker, engine.model_sha256()).await);
        }
        tokio::select! {
            () = sleep(state.limits.job_lease.0 / 3) => {}
            () = stopping.cancelled() => {}
        }
    }
    drop(state.jobs.table.gone(worker).await);
}

/// How far the work on a job is.
pub(super) fn reached(tracker: &RequestTracker) -> Reached {
    let count = |codes: usize| i64::try_from(codes).unwrap_or(i64::MAX);
    let (done, total) = tracker.codes_done();
    Reached {
        stage: tracker.phase().name().to_owned(),
        codes_done: count(done),
        codes_total: count(total),
    }
}

/// Renews a lease; returns once the job is no longer this worker's: it was deleted, or the database
/// did not answer for as long as the lease lasts.
pub(super) async fn until_lost(state: &SharedState, lease: &Lease, tracker: &RequestTracker) {
    let time = state.limits.job_lease.0;
    let mut ends = Instant::now() + time;
    loop {
        sleep(PROGRESS.min(time / 3)).await;
        let asked = Instant::now();
        let left = ends.saturating_duration_since(asked);
        let reached = reached(tracker);
        match timeout(left, state.jobs.table.renew(lease, time, &reached)).await {
            Ok(Ok(true)) => ends = asked + time,
            Ok(Ok(false)) => return,
            Ok(Err(error)) => tracing::warn!(%error, "a lease could not be renewed"),
            Err(_) => {
                tracing::warn!(id = %lease.job.id, "a lease has ended: another worker takes over");
                return;
            }
        }
    }
}
