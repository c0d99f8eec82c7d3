//! Jobs as callers see them: kept, found, listed, deleted.

use std::path::Path;

use sqlx::{Any, any::AnyRow, query::Query};
use uuid::Uuid;

use super::{
    JobRecord, JobsError, Millis, NewJob, State, database::Database, kind::Kind, record::now,
};

/// The table of jobs, in SQLite or PostgreSQL. All replicas of a service share one.
#[derive(Debug)]
pub struct JobTable {
    pub(crate) database: Database,
}

/// What [`JobTable::insert`] did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Inserted {
    /// The job is kept.
    New,
    /// The owner has another of this idempotency key.
    Known(Box<JobRecord>),
}

/// Which jobs to list.
#[derive(Clone, Debug)]
pub struct Listing {
    /// Whose.
    pub owner: String,
    /// In this state only.
    pub state: Option<State>,
    /// Ordered before this one only.
    pub before: Option<(Millis, Uuid)>,
    /// So many at most.
    pub most: u32,
    /// Jobs that finished before this time are gone.
    pub finished_since: Millis,
}

/// The columns that say how far a job is: not what was ordered, nor what is known of the result,
/// which may be long.
macro_rules! brief {
    () => {
        "id, owner, request_id, state, priority, created_at, run_after, expires_at, started_at, \
         finished_at, fetched_at, starts, faults, stage, codes_done, codes_total, model, \
         content_key, idempotency_key, CAST('' AS TEXT) AS order_json, order_bytes, \
         CAST('' AS TEXT) AS result_json, result_bytes, error_json, callback_url, callback_tries"
    };
}

/// Lists an owner's jobs; each of the two has an index that gives them in their order.
macro_rules! list {
    ($state:literal) => {
        concat!(
            "SELECT ",
            brief!(),
            " FROM jobs WHERE owner = $1",
            $state,
            " AND (created_at, id) < ($2, $3) AND (finished_at IS NULL OR finished_at >= $4) \
             ORDER BY created_at DESC, id DESC LIMIT $5"
        )
    };
}

pub(crate) const LIST: &str = list!("");
/// The second condition says nothing new, but that the index of states is the shorter one.
pub(crate) const LIST_STATE: &str =
    list!(" AND state = $6 AND (state, created_at, id) < ($6, $2, $3)");

/// The last job with a result of this content.
pub(crate) const FIND_RESULT: &str = "SELECT * FROM jobs WHERE content_key = $1 \
     AND state = 'done' AND finished_at >= $2 ORDER BY finished_at DESC LIMIT 1";

/// Fails the job $3 at $2 for the reason $1, where `$and` holds of it: its bytes are given back,
/// and its callback is due.
macro_rules! fail_where {
    ($and:literal) => {
        concat!(
            "UPDATE jobs SET state = 'failed', error_json = $1, order_bytes = LENGTH(order_json), \
             result_bytes = 0, finished_at = $2, lease = NULL, lease_until = NULL, stage = NULL, \
             callback_after = \
             CASE WHEN callback_url IS NULL THEN NULL ELSE CAST($2 AS BIGINT) END \
             WHERE id = $3 AND ",
            $and
        )
    };
}
pub(crate) use fail_where;

pub(crate) type Statement = Query<'static, Any, sqlx::any::AnyArguments>;

impl JobTable {
    /// A table in memory, which ends with this value.
    #[must_use]
    pub fn in_memory() -> Self {
        Self { database: Database::in_memory() }
    }

    /// A table in an SQLite file, which is made where there is none.
    #[must_use]
    pub fn in_file(file: &Path) -> Self {
        Self { database: Database::in_file(file) }
    }

    /// The table of a database: `postgres://..`, or `sqlite://FILE`.
    ///
    /// # Errors
    /// [`JobsError::Address`] for any other URL.
    pub fn at_url(url: &str) -> Result<Self, JobsError> {
        Ok(Self { database: Database::at_url(url)? })
    }

    /// Whether replicas on other machines can share the table.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        self.database.kind == Kind::Postgres
    }

    /// Connects and makes the tables, unless that is done; every other call does so too.
    ///
    /// # Errors
    /// [`JobsError::Database`], [`JobsError::Schema`].
    pub async fn open(&self) -> Result<(), JobsError> {
        self.database.pool().await.map(drop)
    }

    pub(crate) async fn rows(&self, statement: Statement) -> Result<Vec<AnyRow>, JobsError> {
        Ok(statement.fetch_all(self.database.pool().await?).await?)
    }

    pub(crate) async fn row(&self, statement: Statement) -> Result<Option<AnyRow>, JobsError> {
        // To its end: a statement of SQLite that changes rows is complete only then.
        Ok(self.rows(statement).await?.into_iter().next())
    }

    /// Runs a statement; whether it changed a row.
    pub(crate) async fn change(&self, statement: Statement) -> Result<bool, JobsError> {
        let changed = statement.execute(self.database.pool().await?).await?;
        Ok(changed.rows_affected() > 0)
    }

    pub(crate) async fn record(
        &self,
        statement: Statement,
    ) -> Result<Option<JobRecord>, JobsError> {
        self.row(statement).await?.as_ref().map(JobRecord::read).transpose()
    }

    /// Keeps a job; once this returns, it survives the process. One with a result is done.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn insert(&self, job: NewJob) -> Result<Inserted, JobsError> {
        const INSERT: &str = "INSERT INTO jobs (id, owner, request_id, state, priority, \
             created_at, run_after, expires_at, finished_at, starts, faults, codes_done, \
             codes_total, model, content_key, idempotency_key, order_json, order_bytes, \
             result_json, result_bytes, callback_url, callback_after) \
             VALUES ($1, $2, $3, $4, $5, $6, 0, $7, $8, 0, 0, 0, 0, $9, $10, $11, $12, $13, $14, \
             $15, $16, $17) ON CONFLICT (owner, idempotency_key) DO NOTHING";
        let (now, done) = (now(), job.result.is_some());
        let text = i64::try_from(job.order.len()).unwrap_or(i64::MAX);
        let (result, result_bytes) = job.result.unzip();
        let result_bytes = result_bytes.unwrap_or(job.expected_bytes);
        let kept = sqlx::query(INSERT)
            .bind(job.id.to_string())
            .bind(job.owner.clone())
            .bind(job.request_id)
            .bind(if done { State::Done } else { State::Queued }.name())
            .bind(job.priority)
            .bind(now)
            .bind(job.expires_at)
            .bind(done.then_some(now))
            .bind(job.model)
            .bind(job.content_key)
            .bind(job.idempotency_key.clone())
            .bind(job.order)
            .bind(job.order_bytes.saturating_add(text))
            .bind(result)
            .bind(result_bytes)
            .bind(job.callback_url.clone())
            .bind(job.callback_url.filter(|_| done).map(|_| now));
        if self.change(kept).await? {
            return Ok(Inserted::New);
        }
        let known = match &job.idempotency_key {
            Some(key) => self.find_idempotent(&job.owner, key).await?,
            None => None,
        };
        let gone = || JobsError::Record {
            id: job.id.to_string(),
            problem: "it was neither kept nor known".to_owned(),
        };
        Ok(Inserted::Known(Box::new(known.ok_or_else(gone)?)))
    }

    /// Finds a job.
    ///
    /// # Errors
    /// [`JobsError::Database`], [`JobsError::Record`].
    pub async fn find(&self, id: Uuid) -> Result<Option<JobRecord>, JobsError> {
        let find = "SELECT * FROM jobs WHERE id = $1";
        self.record(sqlx::query(find).bind(id.to_string())).await
    }

    /// Finds how far a job is: its record without `order` and `result`, which are empty.
    ///
    /// # Errors
    /// As [`JobTable::find`].
    pub async fn look(&self, id: Uuid) -> Result<Option<JobRecord>, JobsError> {
        let look = concat!("SELECT ", brief!(), " FROM jobs WHERE id = $1");
        self.record(sqlx::query(look).bind(id.to_string())).await
    }

    /// Finds the job of an owner's idempotency key.
    ///
    /// # Errors
    /// As [`JobTable::find`].
    pub async fn find_idempotent(
        &self,
        owner: &str,
        key: &str,
    ) -> Result<Option<JobRecord>, JobsError> {
        let find = "SELECT * FROM jobs WHERE owner = $1 AND idempotency_key = $2";
        self.record(sqlx::query(find).bind(owner.to_owned()).bind(key.to_owned())).await
    }

    /// Finds a job with the result of this content, finished since a time.
    ///
    /// # Errors
    /// As [`JobTable::find`].
    pub async fn find_result(
        &self,
        content_key: &str,
        finished_since: Millis,
    ) -> Result<Option<JobRecord>, JobsError> {
        let find = sqlx::query(FIND_RESULT).bind(content_key.to_owned()).bind(finished_since);
        self.record(find).await
    }

    /// Lists jobs, the latest first, as [`JobTable::look`] finds them. A record that cannot be read
    /// is left out, and logged.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn list(&self, listing: Listing) -> Result<Vec<JobRecord>, JobsError> {
        let (before, id) = match listing.before {
            Some((before, id)) => (before, id.to_string()),
            None => (Millis::MAX, String::new()),
        };
        let list = sqlx::query(if listing.state.is_some() { LIST_STATE } else { LIST })
            .bind(listing.owner)
            .bind(before)
            .bind(id)
            .bind(listing.finished_since)
            .bind(i64::from(listing.most));
        let list = match listing.state {
            Some(state) => list.bind(state.name()),
            None => list,
        };
        let readable = |row: &AnyRow| match JobRecord::read(row) {
            Ok(record) => Some(record),
            Err(error) => {
                tracing::error!(%error, "a job is left out of the list");
                None
            }
        };
        Ok(self.rows(list).await?.iter().filter_map(readable).collect())
    }

    /// Notes that a job's result was sent completely.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn fetched(&self, id: Uuid) -> Result<(), JobsError> {
        const CHANGE: &str = "UPDATE jobs SET fetched_at = $1 WHERE id = $2 \
             AND fetched_at IS NULL AND finished_at IS NOT NULL";
        let change = sqlx::query(CHANGE).bind(now()).bind(id.to_string());
        self.change(change).await.map(drop)
    }

    /// Forgets a job, whatever becomes of it; whether there was one. A worker that has it learns
    /// so when it renews its lease.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn delete(&self, id: Uuid) -> Result<bool, JobsError> {
        self.change(sqlx::query("DELETE FROM jobs WHERE id = $1").bind(id.to_string())).await
    }

    /// Whether there is such a job.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn exists(&self, id: Uuid) -> Result<bool, JobsError> {
        let find = sqlx::query("SELECT 1 FROM jobs WHERE id = $1").bind(id.to_string());
        Ok(self.row(find).await?.is_some())
    }
}
