//! Jobs as workers see them: taken on a lease, renewed, finished, given back.

use std::time::Duration;

use uuid::Uuid;

use super::{JobRecord, JobTable, JobsError, Millis, kind::Kind, record::now};

/// The right to work on a job until the lease ends.
#[derive(Clone, Debug)]
pub struct Lease {
    /// The job.
    pub job: JobRecord,
    token: String,
}

/// What a worker takes.
#[derive(Clone, Debug)]
pub struct Claim<'a> {
    /// SHA-256 of the worker's model: jobs that were ordered from another one are left to workers
    /// that have it, as long as there are any.
    pub model: &'a str,
    /// How long the job is the worker's without a renewal.
    pub lease: Duration,
    /// A job that has begun so often is not begun again: its worker did not survive it.
    pub most_starts: i64,
    /// Owners that have their share of this worker.
    pub full: &'a [String],
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

/// The order in which jobs are taken: first those of the owner with the fewest jobs in work, so
/// that a high priority does not hold up other owners; then by priority; then by age. A job that
/// has never failed is taken at once, even if the clock was ahead when it was ordered.
macro_rules! claim {
    ($lock:literal) => {
        concat!(
            "UPDATE jobs SET state = 'running', starts = starts + 1, lease = $1, lease_until = $2, \
             started_at = $3, codes_done = 0, codes_total = 0, stage = NULL WHERE id = (\
             SELECT j.id FROM jobs j LEFT JOIN (SELECT owner, COUNT(*) AS jobs FROM jobs \
             WHERE state = 'running' GROUP BY owner) busy ON busy.owner = j.owner \
             WHERE ((j.state = 'queued' AND (j.run_after <= $3 OR j.faults = 0) \
             AND (j.expires_at IS NULL OR j.expires_at > $3)) \
             OR (j.state = 'running' AND j.lease_until < $3)) AND j.starts < $4 \
             AND $5 NOT LIKE '%|' || j.owner || '|%' \
             AND (j.model = $6 OR NOT EXISTS (SELECT 1 FROM workers w \
             WHERE w.model = j.model AND w.seen_at >= $7)) \
             ORDER BY COALESCE(busy.jobs, 0), j.priority DESC, j.created_at, j.id LIMIT 1",
            $lock,
            ") RETURNING *"
        )
    };
}

impl JobTable {
    /// Takes the next job, if there is one: a queued one, or one whose lease has ended.
    ///
    /// # Errors
    /// [`JobsError::Database`]; [`JobsError::Record`] for a row that cannot be read, which is then
    /// a failed job.
    pub async fn claim(&self, claim: &Claim<'_>) -> Result<Option<Lease>, JobsError> {
        let statement = match self.database.kind {
            Kind::Sqlite => claim!(""),
            Kind::Postgres => claim!(" FOR UPDATE OF j SKIP LOCKED"),
        };
        let (now, token) = (now(), Uuid::new_v4().to_string());
        let full = format!("|{}|", claim.full.join("|"));
        let taken = sqlx::query(statement)
            .bind(token.clone())
            .bind(after(now, claim.lease))
            .bind(now)
            .bind(claim.most_starts)
            .bind(full)
            .bind(claim.model.to_owned())
            .bind(now.saturating_sub(after(0, claim.lease)));
        match self.record(taken).await {
            Ok(job) => Ok(job.map(|job| Lease { job, token })),
            Err(error) => {
                if !matches!(error, JobsError::Database(sqlx::Error::PoolTimedOut)) {
                    self.bury(&token).await?;
                }
                Err(error)
            }
        }
    }

    /// Fails the job whose row was taken with this token and could not be read.
    async fn bury(&self, token: &str) -> Result<(), JobsError> {
        const CHANGE: &str = "UPDATE jobs SET state = 'failed', finished_at = $1, lease = NULL, \
             error_json = NULL WHERE lease = $2";
        let change = sqlx::query(CHANGE).bind(now()).bind(token.to_owned());
        self.change(change).await.map(drop)
    }

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
        const CHANGE: &str = "UPDATE jobs SET state = 'failed', error_json = $1, \
             order_bytes = LENGTH(order_json), finished_at = $2, lease = NULL, \
             lease_until = NULL, stage = NULL, \
             callback_after = CASE WHEN callback_url IS NULL THEN NULL ELSE CAST($2 AS BIGINT) END \
             WHERE id = $3 AND lease = $4";
        let change = sqlx::query(CHANGE)
            .bind(error)
            .bind(now())
            .bind(lease.job.id.to_string())
            .bind(lease.token.clone());
        self.change(change).await
    }

    /// Puts a job back after a fault of the service, to begin again after a time.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn retry(&self, lease: &Lease, wait: Duration) -> Result<bool, JobsError> {
        const CHANGE: &str = "UPDATE jobs SET state = 'queued', faults = faults + 1, \
             run_after = $1, lease = NULL, lease_until = NULL, stage = NULL \
             WHERE id = $2 AND lease = $3";
        let change = sqlx::query(CHANGE)
            .bind(after(now(), wait))
            .bind(lease.job.id.to_string())
            .bind(lease.token.clone());
        self.change(change).await
    }

    /// Puts a job back that could not be worked on, to be taken after a time: that is no start.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn postpone(&self, lease: &Lease, wait: Duration) -> Result<bool, JobsError> {
        const CHANGE: &str = "UPDATE jobs SET state = 'queued', faults = faults + 1, \
             starts = starts - 1, run_after = $1, lease = NULL, lease_until = NULL, \
             stage = NULL, started_at = NULL WHERE id = $2 AND lease = $3";
        let change = sqlx::query(CHANGE)
            .bind(after(now(), wait))
            .bind(lease.job.id.to_string())
            .bind(lease.token.clone());
        self.change(change).await
    }

    /// Gives a job back as if it had not begun: its worker stops.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn release(&self, lease: &Lease) -> Result<bool, JobsError> {
        const CHANGE: &str = "UPDATE jobs SET state = 'queued', starts = starts - 1, lease = NULL, \
             lease_until = NULL, stage = NULL, started_at = NULL WHERE id = $1 AND lease = $2";
        let change = sqlx::query(CHANGE).bind(lease.job.id.to_string()).bind(lease.token.clone());
        self.change(change).await
    }

    /// Fails the jobs that nobody will begin: those that expired in the queue, and those that
    /// began `most_starts` times and whose last worker is gone.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn fail_hopeless(
        &self,
        most_starts: i64,
        expired: String,
        abandoned: String,
    ) -> Result<(), JobsError> {
        const EXPIRE: &str = "UPDATE jobs SET state = 'failed', error_json = $1, finished_at = $2, \
             callback_after = CASE WHEN callback_url IS NULL THEN NULL ELSE CAST($2 AS BIGINT) END \
             WHERE state = 'queued' AND expires_at <= $2";
        const ABANDON: &str = "UPDATE jobs SET state = 'failed', error_json = $1, \
             finished_at = $2, lease = NULL, lease_until = NULL, stage = NULL, \
             callback_after = CASE WHEN callback_url IS NULL THEN NULL ELSE CAST($2 AS BIGINT) END \
             WHERE state = 'running' AND lease_until < $2 AND starts >= $3";
        let now = now();
        self.change(sqlx::query(EXPIRE).bind(expired).bind(now)).await?;
        self.change(sqlx::query(ABANDON).bind(abandoned).bind(now).bind(most_starts)).await?;
        Ok(())
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
