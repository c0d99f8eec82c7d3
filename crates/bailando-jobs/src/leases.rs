//! Jobs as workers see them: on a lease, renewed, finished, put back.

use std::time::Duration;

use uuid::Uuid;

use super::{JobRecord, JobTable, JobsError, Millis, record::now, table::fail_where};

/// The right to work on a job until the lease ends.
#[derive(Clone, Debug)]
pub struct Lease {
    /// The job.
    pub job: JobRecord,
    pub(crate) token: String,
}

/// How far a job is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reached {
    /// What is being done.
    pub stage: String,
    /// Pairs of pose codes that exist.
    pub codes_done: i64,
    /// Pairs of pose codes of the whole dance.
    pub codes_total: i64,
}

/// Why a worker puts a job back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PutBack {
    /// After a fault of the service: it begins again after a time.
    Retry(Duration),
    /// It could not be worked on, which is no start, and may be after a time.
    Postpone(Duration),
    /// Its worker stops: it is as if it had not begun, and may begin at once.
    Release,
}

/// Longest time for which a job is put back. One that is to wait for longer was put back before the
/// clock was set back.
pub const LONGEST_WAIT: Duration = Duration::from_secs(60);

impl JobTable {
    /// Renews a lease, and says how far the job is. False if the job is no longer the worker's: it
    /// was deleted, or the lease had ended and another worker took it.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn renew(
        &self,
        lease: &Lease,
        time: Duration,
        reached: &Reached,
    ) -> Result<bool, JobsError> {
        const CHANGE: &str = "UPDATE jobs SET lease_until = $1, stage = $2, codes_done = $3, \
             codes_total = $4 WHERE id = $5 AND lease = $6";
        let change = sqlx::query(CHANGE)
            .bind(after(now(), time))
            .bind(reached.stage.clone())
            .bind(reached.codes_done)
            .bind(reached.codes_total)
            .bind(lease.job.id.to_string())
            .bind(lease.token.clone());
        self.change(change).await
    }

    /// Ends a job with its result; its song is needed no more. False if it is no longer the
    /// worker's.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn done(
        &self,
        lease: &Lease,
        result: String,
        bytes: i64,
        reached: &Reached,
    ) -> Result<bool, JobsError> {
        const CHANGE: &str = "UPDATE jobs SET state = 'done', result_json = $1, result_bytes = $2, \
             order_bytes = LENGTH(order_json), finished_at = $3, lease = NULL, \
             lease_until = NULL, stage = NULL, \
             codes_done = $4, codes_total = $5, \
             callback_after = CASE WHEN callback_url IS NULL THEN NULL ELSE CAST($3 AS BIGINT) END \
             WHERE id = $6 AND lease = $7";
        let change = sqlx::query(CHANGE)
            .bind(result)
            .bind(bytes)
            .bind(now())
            .bind(reached.codes_done)
            .bind(reached.codes_total)
            .bind(lease.job.id.to_string())
            .bind(lease.token.clone());
        self.change(change).await
    }

    /// Ends a job with the reason why it has no result. False if it is no longer the worker's.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn fail(&self, lease: &Lease, error: String) -> Result<bool, JobsError> {
        let change = sqlx::query(fail_where!("lease = $4"))
            .bind(error)
            .bind(now())
            .bind(lease.job.id.to_string())
            .bind(lease.token.clone());
        self.change(change).await
    }

    /// Puts a job back, for [`LONGEST_WAIT`] at most. False if it is no longer the worker's.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn put_back(&self, lease: &Lease, why: PutBack) -> Result<bool, JobsError> {
        const CHANGE: &str = "UPDATE jobs SET state = 'queued', faults = faults + $1, \
             starts = starts - $2, run_after = $3, lease = NULL, lease_until = NULL, stage = NULL, \
             started_at = CASE WHEN $2 = 0 THEN started_at ELSE NULL END \
             WHERE id = $4 AND lease = $5";
        let at = |wait: Duration| after(now(), wait.min(LONGEST_WAIT));
        let (faults, starts, run_after): (i64, i64, Millis) = match why {
            PutBack::Retry(wait) => (1, 0, at(wait)),
            PutBack::Postpone(wait) => (1, 1, at(wait)),
            PutBack::Release => (0, 1, 0),
        };
        let change = sqlx::query(CHANGE)
            .bind(faults)
            .bind(starts)
            .bind(run_after)
            .bind(lease.job.id.to_string())
            .bind(lease.token.clone());
        self.change(change).await
    }

    /// Says that a worker with this model lives, and forgets those that have not said so for long.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn alive(&self, worker: Uuid, model: &str) -> Result<(), JobsError> {
        const UPSERT: &str = "INSERT INTO workers (id, model, seen_at) VALUES ($1, $2, $3) \
             ON CONFLICT (id) DO UPDATE SET model = $2, seen_at = $3";
        const FORGOTTEN_AFTER: Millis = 3_600_000;
        let now = now();
        let alive = sqlx::query(UPSERT).bind(worker.to_string()).bind(model.to_owned()).bind(now);
        self.change(alive).await?;
        let forget = "DELETE FROM workers WHERE seen_at < $1";
        self.change(sqlx::query(forget).bind(now - FORGOTTEN_AFTER)).await.map(drop)
    }

    /// Says that a worker is about to end.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn gone(&self, worker: Uuid) -> Result<(), JobsError> {
        let delete = "DELETE FROM workers WHERE id = $1";
        self.change(sqlx::query(delete).bind(worker.to_string())).await.map(drop)
    }
}

pub(crate) fn after(time: Millis, wait: Duration) -> Millis {
    time.saturating_add(Millis::try_from(wait.as_millis()).unwrap_or(Millis::MAX))
}
