//! Ends of jobs that are still to be reported.

use std::time::Duration;

use sqlx::Row;
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
    /// [`JobsError::Database`]; [`JobsError::Record`] for a row that cannot be read, of which
    /// nothing is reported.
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
        let Some(row) = self.row(due).await? else { return Ok(None) };
        let read = JobRecord::read(&row);
        if read.is_err() {
            // It would be tried for as long as the job is kept.
            let change = "UPDATE jobs SET callback_after = NULL WHERE id = $1";
            let id: String = row.try_get("id")?;
            self.change(sqlx::query(change).bind(id)).await?;
        }
        read.map(Some)
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
