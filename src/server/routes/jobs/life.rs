//! A job's life, from its order until its result is deleted.

use std::{sync::Arc, time::Duration};

use tokio::time::{Instant, sleep_until};
use tokio_util::task::task_tracker::TaskTrackerToken;

use crate::{
    formats::GeneratedMotion,
    server::{
        error::ServerError,
        intake::Order,
        jobs::{Finished, Job, JobState},
        resources::{Permit, Stay},
        response::answer::Answers,
        state::SharedState,
        work,
    },
};

/// A client that has not asked about its job for so long is not waited for when the server stops.
const AWAITED: Duration = Duration::from_secs(5);
/// And no longer than this in all, once the job is done.
const AWAITED_AT_MOST: Duration = Duration::from_secs(10);
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// Works on a job, and keeps what has become of it for its time.
pub(super) async fn live(
    state: SharedState,
    mut order: Order,
    job: Arc<Job>,
    under_way: TaskTrackerToken,
) {
    let done = tokio::select! {
        biased;
        () = job.deleted.cancelled() => return,
        done = run(&state, &mut order, &job) => done,
        () = state.lifecycle.aborted() => Err(state.draining()),
    };
    let Order { options, shape, waiting, .. } = order;
    job.turn(match done {
        Ok(dance) => JobState::Done(Arc::new(Finished {
            dance: Arc::new(dance),
            answers: Answers::default(),
            options,
            format: shape.format,
        })),
        Err(error) => {
            let report = error.report();
            state.metrics.rejected(report.error_type);
            JobState::Failed(report.repeated(&job.request_id))
        }
    });
    waiting.answered();
    keep(state, job, under_way).await;
}

/// Keeps a job's result for its time. The server stops only when the result was fetched, or when
/// its client no longer asks for it: it would be lost.
async fn keep(state: SharedState, job: Arc<Job>, under_way: TaskTrackerToken) {
    let expiry = Instant::now() + state.limits.job_ttl.0;
    let wait = async {
        state.lifecycle.draining().await;
        // Within the time that there is: nothing is lost by then.
        let most = AWAITED_AT_MOST.min(state.limits.shutdown_timeout.0 / 2);
        let until = Instant::now() + most;
        while job.is_awaited(AWAITED) && Instant::now() < until {
            tokio::time::sleep(LOOK_AGAIN).await;
        }
    };
    tokio::select! {
        () = wait => {}
        () = job.fetched.cancelled() => {}
        () = job.deleted.cancelled() => {}
        () = sleep_until(expiry) => {
            state.jobs.remove(job.id);
        }
    }
    drop(under_way);
    // Fetched ones are kept for the rest of their time, in case that somebody asks again.
    if job.fetched.is_cancelled() {
        tokio::select! {
            () = job.deleted.cancelled() => {}
            () = state.lifecycle.draining() => {}
            () = sleep_until(expiry) => {
                state.jobs.remove(job.id);
            }
        }
    }
}

async fn run(
    state: &SharedState,
    order: &mut Order,
    job: &Job,
) -> Result<GeneratedMotion, ServerError> {
    let ordered = Instant::now();
    let _slot = state.resources.job_workers.take(job.owner, Stay::Long).await;
    let mut permit = state.resources.admission.admit_unqueued(job.owner, Stay::Long).await;
    permit.waited = ordered.elapsed();
    job.turn(JobState::Running);
    let limit = state.limits.job_timeout;
    let dance = tokio::time::timeout(limit.0, work::dance(state, order, permit, "job")).await;
    let retry_after = state.resources.retry_after();
    let (dance, work) = dance.map_err(|_| ServerError::JobTimeout { limit, retry_after })??;
    work.end().into_iter().for_each(Permit::complete);
    Ok(dance)
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;
    use crate::server::{
        config::{Limits, Seconds},
        layers::client::Client,
        metrics::SharedMetrics,
        state::ServerState,
        tracker::RequestTracker,
    };

    fn job(state: &SharedState) -> Arc<Job> {
        let metrics = Arc::clone(&state.metrics);
        let tracker = RequestTracker::new(Arc::clone(&metrics));
        Job::new(Client::Unknown, "id".to_owned(), tracker, metrics)
    }

    #[tokio::test]
    async fn nothing_is_left_of_a_job_that_made_room() {
        let limits = Limits { max_jobs: NonZeroUsize::MIN, ..Limits::default() };
        let state = ServerState::loading(limits, SharedMetrics::default());
        let first = job(&state);
        state.jobs.put(Arc::clone(&first)).unwrap();
        first.turn(JobState::Failed(ServerError::MissingAudio.report()));
        first.fetched.cancel();
        let left = Arc::downgrade(&first);
        let under_way = state.lifecycle.go_on();
        let kept = tokio::spawn(keep(Arc::clone(&state), first, under_way));
        // It is kept, though it was fetched.
        while state.lifecycle.under_way() > 0 {
            tokio::task::yield_now().await;
        }
        assert!(left.upgrade().is_some());
        state.jobs.put(job(&state)).unwrap();
        let ended = tokio::time::timeout(Duration::from_secs(15), kept).await;
        ended.expect("it is let go at once").unwrap();
        assert!(left.upgrade().is_none());
    }

    #[tokio::test]
    async fn a_fetched_job_is_kept_for_the_rest_of_its_time_and_no_longer() {
        let time = Duration::from_secs(1);
        let limits = Limits { job_ttl: Seconds(time), ..Limits::default() };
        let state = ServerState::loading(limits, SharedMetrics::default());
        let job = job(&state);
        let started = Instant::now();
        let kept = keep(Arc::clone(&state), Arc::clone(&job), state.lifecycle.go_on());
        let fetch = async {
            tokio::time::sleep(time * 9 / 10).await;
            job.fetched.cancel();
        };
        tokio::join!(kept, fetch);
        // Counted from the fetch, it would be 1.9 s.
        assert!((time..time * 18 / 10).contains(&started.elapsed()));
    }
}
