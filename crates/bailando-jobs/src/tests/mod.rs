//! The same tests for each database.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that fails panics")]

mod clocks;
mod files;
mod jobs;
mod migrations;
mod plans;
mod turns;

use std::{sync::Arc, time::Duration};

use bailando_testkit::postgres::Postgres;
use uuid::Uuid;

use crate::{Claim, Inserted, JobRecord, JobTable, Lease, NewJob, Reached};

const LONG: Duration = Duration::from_secs(60);
const SHORT: Duration = Duration::from_millis(30);

/// Runs a test with a table in memory, in a file, and in PostgreSQL where that is installed.
fn with_each(test: impl AsyncFn(Arc<JobTable>)) {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(test(Arc::new(JobTable::in_memory())));
    let folder = tempfile::tempdir().unwrap();
    let file = JobTable::in_file(&folder.path().join("jobs.sqlite"));
    runtime.block_on(test(Arc::new(file)));
    if let Some(postgres) = Postgres::start() {
        runtime.block_on(test(Arc::new(JobTable::at_url(&postgres.url()).unwrap())));
    }
}

fn claim(lease: Duration) -> Claim<'static> {
    Claim { model: "model", lease, most_starts: 3, full: &[] }
}

fn job(owner: &str) -> NewJob {
    NewJob { model: "model".to_owned(), ..NewJob::new(owner, "{}") }
}

async fn insert(jobs: &JobTable, job: NewJob) -> Uuid {
    let id = job.id;
    assert_eq!(jobs.insert(job).await.unwrap(), Inserted::New);
    id
}

async fn find(jobs: &JobTable, id: Uuid) -> JobRecord {
    jobs.find(id).await.unwrap().unwrap()
}

async fn take(jobs: &JobTable) -> Option<Lease> {
    jobs.claim(&claim(LONG)).await.unwrap()
}

fn reached(done: i64) -> Reached {
    Reached { stage: "inference".to_owned(), codes_done: done, codes_total: 9 }
}
