//! Jobs are taken in turns.

use std::time::Duration;

use sqlx::Row;
use uuid::Uuid;

use super::{JobTable, JobsError, Lease, Millis, leases::after, record::now, table::fail_where};

/// What a worker takes.
#[derive(Clone, Debug)]
pub struct Claim<'a> {
    /// SHA-256 of the worker's model: jobs that were ordered from another one are left to workers
    /// that have it, as long as there are any.
    pub model: &'a str,
    /// How long the job is the worker's without a renewal.
    pub lease: Duration,
    /// A job that has begun so often and whose worker is gone is not begun again: no worker
    /// survives it.
    pub most_starts: i64,
    /// Owners that have their share of this worker.
    pub full: &'a [String],
}

/// A job that waits in line.
macro_rules! ready {
    () => {
        "j.state = 'queued' AND j.run_after = 0"
    };
}

/// A line of jobs: those of one owner that were ordered from one model.
macro_rules! lane {
    () => {
        "j.model || '|' || j.owner"
    };
}

/// The job that is next: one of the owner with the fewest jobs in work, so that a high priority
/// does not hold up other owners; then by priority; then by age. Of $1 model, $2 the least and $3
/// the greatest time at which a worker that lives was seen, $4 now, $5 most starts, $6 full owners.
///
/// As rows are read in the order of an index and no further than needed, what it costs does not
/// depend on how many jobs wait:
/// - `idle`: an owner with nothing in work is mostly found among the first of the whole line; its
///   first job there is the first of all such owners. Not asked while jobs of several models wait.
/// - else `lanes` goes from each owner that waits to the next, and `heads` has the first job of
///   each;
/// - jobs whose wait is over and that do not stand in line yet, and those whose lease has ended:
///   there are few.
pub(crate) const NEXT: &str = concat!(
    "WITH RECURSIVE idle (id) AS (SELECT f.id FROM (\
     SELECT j.id, j.owner, j.priority, j.created_at, j.expires_at FROM jobs j WHERE ",
    ready!(),
    " AND j.model = $1 ORDER BY j.priority DESC, j.created_at, j.id LIMIT 100) f \
     WHERE (f.expires_at IS NULL OR f.expires_at > $4) \
     AND REPLACE($6, '|' || f.owner || '|', '') = $6 \
     AND NOT EXISTS (SELECT 1 FROM jobs b WHERE b.state = 'running' AND b.owner = f.owner) \
     AND NOT EXISTS (SELECT 1 FROM jobs j WHERE ",
    ready!(),
    " AND j.model < $1) AND NOT EXISTS (SELECT 1 FROM jobs j WHERE ",
    ready!(),
    " AND j.model > $1) ORDER BY f.priority DESC, f.created_at, f.id LIMIT 1), \
     lanes (lane) AS (SELECT (SELECT MIN(",
    lane!(),
    ") FROM jobs j WHERE ",
    ready!(),
    ") WHERE NOT EXISTS (SELECT 1 FROM idle) UNION ALL SELECT (SELECT MIN(",
    lane!(),
    ") FROM jobs j WHERE ",
    ready!(),
    " AND ",
    lane!(),
    " > l.lane) FROM lanes l WHERE l.lane IS NOT NULL), \
     heads (id) AS (SELECT id FROM idle UNION ALL SELECT (SELECT j.id FROM jobs j WHERE ",
    ready!(),
    " AND ",
    lane!(),
    " = l.lane AND (j.expires_at IS NULL OR j.expires_at > $4) \
     ORDER BY j.priority DESC, j.created_at, j.id LIMIT 1) FROM lanes l WHERE l.lane IS NOT NULL \
     UNION ALL SELECT j.id FROM jobs j WHERE j.state = 'queued' AND j.run_after > 0 \
     AND j.run_after <= $4 AND (j.expires_at IS NULL OR j.expires_at > $4) \
     UNION ALL SELECT j.id FROM jobs j WHERE j.state = 'running' AND j.lease_until < $4 \
     AND j.starts < $5) \
     SELECT j.id FROM jobs j WHERE j.id IN (SELECT id FROM heads) \
     AND REPLACE($6, '|' || j.owner || '|', '') = $6 \
     AND (j.model = $1 OR NOT EXISTS (SELECT 1 FROM workers w \
     WHERE w.model = j.model AND w.seen_at BETWEEN $2 AND $3)) \
     ORDER BY (SELECT COUNT(*) FROM jobs b WHERE b.state = 'running' AND b.owner = j.owner), \
     j.priority DESC, j.created_at, j.id LIMIT 1"
);

/// Takes a job, unless another worker was faster.
const TAKE: &str = "UPDATE jobs SET state = 'running', starts = starts + 1, lease = $1, \
     lease_until = $2, started_at = $3, run_after = 0, codes_done = 0, codes_total = 0, \
     stage = NULL WHERE id = $4 AND ((state = 'queued' AND run_after <= $3) \
     OR (state = 'running' AND lease_until < $3)) RETURNING *";

impl JobTable {
    /// Takes the next job, if there is one: a queued one, or one whose lease has ended. To look for
    /// it changes nothing, so that workers with nothing to do keep no one waiting.
    ///
    /// # Errors
    /// [`JobsError::Database`]; [`JobsError::Record`] for a row that cannot be read, which is then
    /// a failed job.
    pub async fn claim(&self, claim: &Claim<'_>) -> Result<Option<Lease>, JobsError> {
        loop {
            let Some(id) = self.next(claim, now()).await? else { return Ok(None) };
            // The clock is read again: the search may have waited, and found a job that was ordered
            // in the meantime. Where another worker was faster one more job was taken: this ends.
            if let Some(lease) = self.take(id, claim.lease, now()).await? {
                return Ok(Some(lease));
            }
        }
    }

    async fn next(&self, claim: &Claim<'_>, now: Millis) -> Result<Option<String>, JobsError> {
        let lease = after(0, claim.lease);
        let next = sqlx::query(NEXT)
            .bind(claim.model.to_owned())
            .bind(now.saturating_sub(lease))
            .bind(now.saturating_add(lease))
            .bind(now)
            .bind(claim.most_starts)
            .bind(named(claim.full));
        self.row(next).await?.map_or(Ok(None), |row| Ok(Some(row.try_get(0)?)))
    }

    async fn take(
        &self,
        id: String,
        lease: Duration,
        now: Millis,
    ) -> Result<Option<Lease>, JobsError> {
        let token = Uuid::new_v4().to_string();
        let taken = sqlx::query(TAKE)
            .bind(token.clone())
            .bind(after(now, lease))
            .bind(now)
            .bind(id.clone());
        match self.record(taken).await {
            Ok(job) => Ok(job.map(|job| Lease { job, token })),
            Err(error) => {
                // After any other error, the job is taken again once its lease has ended.
                if error.is_unreadable() {
                    self.bury(id, token).await?;
                }
                Err(error)
            }
        }
    }

    /// Fails a job that was taken with this token and whose row cannot be read.
    async fn bury(&self, id: String, token: String) -> Result<(), JobsError> {
        let change = sqlx::query(fail_where!("lease = $4"));
        let change = change.bind(None::<String>).bind(now()).bind(id).bind(token);
        self.change(change).await.map(drop)
    }
}

/// Owners as one value, in which a statement looks for `|owner|`.
pub(crate) fn named(owners: &[String]) -> String {
    owners.iter().map(|owner| format!("|{owner}|")).collect()
}
