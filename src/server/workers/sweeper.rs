//! Order among jobs: what nobody will begin fails, what has waited stands in line again, what has
//! expired goes, and so do files that belong to no job.

use std::{collections::HashSet, time::Duration};

use bailando_jobs::JobsError;
use futures_util::TryStreamExt;
use tokio::time::{Instant, sleep};
use uuid::Uuid;

use crate::server::{
    error::ServerError,
    jobs::{
        order::{StoredError, to_text},
        service::Jobs,
    },
    state::SharedState,
};

/// Longest time between two looks.
const LOOK_AGAIN: Duration = Duration::from_secs(5);
/// Time between two looks at all files.
const FILES: Duration = Duration::from_secs(3600);
/// Files of no job that are younger may be those of an order that is about to be kept.
const YOUNG: Duration = Duration::from_secs(3600);

/// Sweeps until the process stops.
pub(super) async fn sweep(state: SharedState) {
    let stopping = state.lifecycle.stopping();
    let mut files_due = Instant::now();
    loop {
        if let Err(error) = once(&state).await {
            tracing::warn!(%error, "jobs could not be swept");
        }
        if state.jobs.durable && Instant::now() >= files_due {
            files_due = Instant::now() + FILES;
            tokio::select! {
                swept = files(&state.jobs) => {
                    if let Err(error) = swept {
                        tracing::warn!(%error, "files of no job could not be swept");
                    }
                }
                () = stopping.cancelled() => return,
            }
        }
        tokio::select! {
            () = sleep(LOOK_AGAIN.min(state.limits.job_lease.0)) => {}
            () = stopping.cancelled() => return,
        }
    }
}

async fn once(state: &SharedState) -> Result<(), ServerError> {
    let starts = state.limits.job_starts.get();
    let abandoned = ServerError::Abandoned { starts };
    let text = |error: &ServerError| to_text(&StoredError::new(&error.shown()));
    let (expired, abandoned) = (text(&ServerError::JobExpired)?, text(&abandoned)?);
    let most = i64::try_from(starts).unwrap_or(i64::MAX);
    let table = &state.jobs.table;
    let failed = table.fail_hopeless(most, expired, abandoned).await?;
    table.line_up(state.limits.job_lease.0).await?;
    state.jobs.expire().await?;
    for id in failed {
        // It is deleted with the job at the latest.
        state.jobs.files.delete(&Jobs::song(id)).await?;
    }
    Ok(())
}

/// Deletes files whose jobs are gone, and what killed processes left.
async fn files(jobs: &Jobs) -> Result<(), JobsError> {
    let mut old = jobs.files.older_than("jobs", YOUNG);
    let mut seen = HashSet::new();
    while let Some(name) = old.try_next().await? {
        let id = name.split('/').nth(1).and_then(|id| Uuid::try_parse(id).ok());
        let Some(id) = id.filter(|id| seen.insert(*id)) else { continue };
        if !jobs.table.exists(id).await? {
            jobs.files.delete_below(&Jobs::folder(id)).await?;
        }
    }
    let store = jobs.files.clone();
    // Nothing is left to be done if it panics.
    drop(tokio::task::spawn_blocking(move || store.delete_fragments(YOUNG)).await);
    Ok(())
}
