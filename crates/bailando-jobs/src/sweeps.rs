//! What time itself changes about jobs.

use std::time::Duration;

use sqlx::Row;
use uuid::Uuid;

use super::{
    JobTable, JobsError, LONGEST_WAIT, Millis,
    leases::after,
    record::now,
    table::{Statement, fail_where},
};

/// How to find jobs without hope at the time $1, and how to fail one of them: each by itself, since
/// the schema counts the bytes of one job at a time. One that was taken meanwhile is left as it is.
macro_rules! hopeless {
    ($which:literal, $still:literal) => {
        (concat!("SELECT id FROM jobs WHERE ", $which, " LIMIT 1000"), fail_where!($still))
    };
}

/// Those that expired in the queue.
pub(crate) const EXPIRED: (&str, &str) = hopeless!(
    "state = 'queued' AND expires_at IS NOT NULL AND expires_at <= $1",
    "state NOT IN ('running', 'done', 'failed')"
);
/// Those whose last worker is gone.
pub(crate) const ABANDONED: (&str, &str) = hopeless!(
    "state = 'running' AND lease_until < $1 AND starts >= $2",
    "state NOT IN ('queued', 'done', 'failed') AND lease_until < $2"
);
/// As many as one statement changes at most: others write in between. One that was taken meanwhile
/// is left alone; said in such a way that no index of states is asked.
pub(crate) const LINE_UP: &str = "UPDATE jobs SET run_after = 0 WHERE id IN (\
     SELECT id FROM jobs WHERE state = 'queued' AND run_after > 0 \
     AND run_after BETWEEN $1 AND $2 LIMIT 1000) AND state NOT IN ('running', 'done', 'failed')";
pub(crate) const CUT: &str =
    "UPDATE jobs SET lease_until = $1 WHERE state = 'running' AND lease_until > $2";

impl JobTable {
    /// Fails the jobs that nobody will begin: those that expired in the queue, and those that
    /// began `most_starts` times and whose last worker is gone. Their songs are needed no more.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn fail_hopeless(
        &self,
        most_starts: i64,
        expired: String,
        abandoned: String,
    ) -> Result<Vec<Uuid>, JobsError> {
        let now = now();
        let (which, fail) = EXPIRED;
        let which = || sqlx::query(which).bind(now);
        let mut failed = self.fail_each(which, fail, expired, now).await?;
        let (which, fail) = ABANDONED;
        let which = || sqlx::query(which).bind(now).bind(most_starts);
        failed.extend(self.fail_each(which, fail, abandoned, now).await?);
        Ok(failed)
    }

    /// Fails all jobs that `which` finds some of, each with `fail`.
    async fn fail_each(
        &self,
        which: impl Fn() -> Statement,
        fail: &'static str,
        reason: String,
        now: Millis,
    ) -> Result<Vec<Uuid>, JobsError> {
        let mut failed = Vec::new();
        loop {
            let mut changed = false;
            for row in &self.rows(which()).await? {
                let id: String = row.try_get(0)?;
                let fail = sqlx::query(fail).bind(reason.clone()).bind(now).bind(id.clone());
                if self.change(fail).await? {
                    changed = true;
                    failed.extend(Uuid::try_parse(&id));
                }
            }
            // What cannot be changed now is left to the next sweep.
            if !changed {
                return Ok(failed);
            }
        }
    }

    /// Puts jobs whose wait is over in line with the others, and ends the waits and leases that
    /// last longer than any does: from before the clock was set back, they would last until it has
    /// caught up.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn line_up(&self, longest_lease: Duration) -> Result<(), JobsError> {
        let now = now();
        // Clocks of replicas differ by a little, which may not end what is of now.
        let too_late = |longest: Duration| after(now, longest * 2);
        for (from, to) in [(0, now), (too_late(LONGEST_WAIT), i64::MAX)] {
            while self.change(sqlx::query(LINE_UP).bind(from).bind(to)).await? {}
        }
        let cut = sqlx::query(CUT).bind(after(now, longest_lease)).bind(too_late(longest_lease));
        self.change(cut).await.map(drop)
    }
}
