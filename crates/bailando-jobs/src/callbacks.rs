//! Ends of jobs that are still to be reported.

use std::time::Duration;

use uuid::Uuid;

use super::{
    JobRecord, JobTable, JobsError, claims::named, kind::Kind, leases::after, record::now,
};

macro_rules! due {
    ($lock:literal) => {
        concat!(
            "UPDATE jobs SET callback_after = $1, callback_tries = callback_tries + 1 WHERE id = (\
             SELECT id FROM jobs WHERE callback_after <= $2 \
             AND REPLACE($3, '|' || owner || '|', '') = $3 ORDER BY callback_after LIMIT 1",
            $lock,
            ") RETURNING *"
        )
    };
}

impl JobTable {
    /// Takes a job whose end is to be reported now, of none of the owners that are `full`. It is
    /// taken again after `lease`, unless [`JobTable::reported`] says how it went.
    ///
    /// # Errors
    /// As [`JobTable::find`].
    pub async fn due_callback(
        &self,
        lease: Duration,
        full: &[String],
    ) -> Result<Option<JobRecord>, JobsError> {
        let statement = match self.database.kind {
            Kind::Sqlite => due!(""),
            Kind::Postgres => due!(" FOR UPDATE SKIP LOCKED"),
        };
        let now = now();
        let due = sqlx::query(statement).bind(after(now, lease)).bind(now).bind(named(full));
        self.record(due).await
    }

    /// Says that the end of a job was reported, or will be tried again after `again`.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn reported(&self, id: Uuid, again: Option<Duration>) -> Result<(), JobsError> {
        let change = "UPDATE jobs SET callback_after = $1 WHERE id = $2";
        let next = again.map(|again| after(now(), again));
        self.change(sqlx::query(change).bind(next).bind(id.to_string())).await.map(drop)
    }
}
