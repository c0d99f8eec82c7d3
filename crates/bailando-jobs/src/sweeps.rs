//! What time itself changes about jobs.

use std::time::Duration;

use super::{JobTable, JobsError, LONGEST_WAIT, leases::after, record::now};

/// Jobs in the queue, as many as one statement changes at most: others write in between. One that
/// was taken meanwhile is left alone; said in such a way that no index of states is asked.
macro_rules! some_queued {
    ($and:literal) => {
        concat!(
            "id IN (SELECT id FROM jobs WHERE state = 'queued' AND ",
            $and,
            " LIMIT 1000) AND state NOT IN ('running', 'done', 'failed')"
        )
    };
}

/// The reason is $1, now $2.
macro_rules! failed {
    () => {
        "UPDATE jobs SET state = 'failed', error_json = $1, finished_at = $2, lease = NULL, \
         lease_until = NULL, stage = NULL, \
         callback_after = CASE WHEN callback_url IS NULL THEN NULL ELSE CAST($2 AS BIGINT) END \
         WHERE "
    };
}

pub(crate) const EXPIRE: &str =
    concat!(failed!(), some_queued!("expires_at IS NOT NULL AND expires_at <= $2"));
pub(crate) const ABANDON: &str =
    concat!(failed!(), "state = 'running' AND lease_until < $2 AND starts >= $3");
pub(crate) const LINE_UP: &str = concat!(
    "UPDATE jobs SET run_after = 0 WHERE ",
    some_queued!("run_after > 0 AND run_after BETWEEN $1 AND $2")
);
pub(crate) const CUT: &str =
    "UPDATE jobs SET lease_until = $1 WHERE state = 'running' AND lease_until > $2";

impl JobTable {
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
        let now = now();
        while self.change(sqlx::query(EXPIRE).bind(expired.clone()).bind(now)).await? {}
        self.change(sqlx::query(ABANDON).bind(abandoned).bind(now).bind(most_starts)).await?;
        Ok(())
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
