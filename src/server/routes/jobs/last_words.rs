//! What the end of the process waits for, where jobs end with it.

use std::time::Duration;

use bailando_jobs::JobRecord;
use tokio::time::{Instant, sleep};
use tokio_util::task::task_tracker::TaskTrackerToken;
use uuid::Uuid;

use crate::server::state::SharedState;

/// A client that has not asked about its job for so long is not waited for when the server stops.
const AWAITED: Duration = Duration::from_secs(5);
/// And no longer than this in all, once the job is done.
const AWAITED_AT_MOST: Duration = Duration::from_secs(10);
const LOOK_AGAIN: Duration = Duration::from_millis(50);
const LOOK_NOW_AND_THEN: Duration = Duration::from_secs(5);

/// Holds the process until a job is done and its result was fetched, or nobody asks for it.
pub(super) async fn wait(state: SharedState, id: Uuid, under_way: TaskTrackerToken) {
    let settled = async {
        while needed(&state, id).await.is_some() {
            sleep(LOOK_NOW_AND_THEN).await;
        }
    };
    let stops = tokio::select! {
        () = state.lifecycle.draining() => true,
        () = settled => false,
    };
    let most = AWAITED_AT_MOST.min(state.limits.shutdown_timeout.0 / 2);
    let mut done = None;
    while stops && let Some(job) = needed(&state, id).await {
        if job.state.is_final() {
            let done = *done.get_or_insert_with(Instant::now);
            let asked = state.jobs.asked(id).map_or(done, |asked| asked.max(done));
            if asked.elapsed() > AWAITED || done.elapsed() > most {
                break;
            }
        }
        sleep(LOOK_AGAIN).await;
    }
    drop(state);
    drop(under_way);
}

/// A job whose result nobody has fetched; in memory, the table answers at once.
async fn needed(state: &SharedState, id: Uuid) -> Option<JobRecord> {
    let job = state.jobs.table.find(id).await.ok().flatten();
    job.filter(|job| job.fetched_at.is_none())
}
