//! Jobs as callers see them: kept, found, listed, counted, deleted.

use std::path::Path;

use sqlx::{Any, Row, any::AnyRow, query::Query};
use uuid::Uuid;

use super::{
    JobRecord, JobsError, Millis, NewJob, State, database::Database, kind::Kind, record::now,
};

/// The table of jobs, in SQLite or PostgreSQL. All replicas of a service share one.
#[derive(Debug)]
pub struct JobTable {
    pub(crate) database: Database,
}

/// How many jobs are kept, and of whom.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Jobs in all.
    pub jobs: i64,
    /// Jobs of the owner that was asked about.
    pub own: i64,
    /// Bytes of all orders, songs and results.
    pub bytes: i64,
    /// Bytes of those of the owner that was asked about.
    pub own_bytes: i64,
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

type Statement = Query<'static, Any, sqlx::any::AnyArguments>;

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
             VALUES ($1, $2, $3, $4, $5, $6, $6, $7, $8, 0, 0, 0, 0, $9, $10, $11, $12, $13, $14, \
             $15, $16, $17) ON CONFLICT (owner, idempotency_key) DO NOTHING";
        let (now, done) = (now(), job.result.is_some());
        let text = i64::try_from(job.order.len()).unwrap_or(i64::MAX);
        let (result, result_bytes) = job.result.unzip();
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
            .bind(result_bytes.unwrap_or(0))
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
        let find = "SELECT * FROM jobs WHERE content_key = $1 AND state = 'done' \
             AND finished_at >= $2 ORDER BY finished_at DESC LIMIT 1";
        let find = sqlx::query(find).bind(content_key.to_owned()).bind(finished_since);
        self.record(find).await
    }

    /// Lists jobs, the latest first, as [`JobTable::look`] finds them. A record that cannot be read
    /// is left out, and logged.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn list(&self, listing: Listing) -> Result<Vec<JobRecord>, JobsError> {
        const LIST: &str = concat!(
            "SELECT ",
            brief!(),
            " FROM jobs WHERE owner = $1 AND (state = $2 OR $2 = '') \
             AND (created_at < $3 OR (created_at = $3 AND id < $4)) \
             AND (finished_at IS NULL OR finished_at >= $5) \
             ORDER BY created_at DESC, id DESC LIMIT $6"
        );
        let (before, id) = match listing.before {
            Some((before, id)) => (before, id.to_string()),
            None => (Millis::MAX, String::new()),
        };
        let list = sqlx::query(LIST)
            .bind(listing.owner)
            .bind(listing.state.map_or("", State::name))
            .bind(before)
            .bind(id)
            .bind(listing.finished_since)
            .bind(i64::from(listing.most));
        let readable = |row: &AnyRow| match JobRecord::read(row) {
            Ok(record) => Some(record),
            Err(error) => {
                tracing::error!(%error, "a job is left out of the list");
                None
            }
        };
        Ok(self.rows(list).await?.iter().filter_map(readable).collect())
    }

    /// Counts the jobs in each state.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn count(&self) -> Result<Vec<(State, i64)>, JobsError> {
        let count = "SELECT state, COUNT(*) FROM jobs GROUP BY state";
        let mut counts = State::ALL.map(|state| (state, 0)).to_vec();
        for row in self.rows(sqlx::query(count)).await? {
            let (name, jobs): (String, i64) = (row.try_get(0)?, row.try_get(1)?);
            let known = counts.iter_mut().find(|(state, _)| state.name() == name);
            known.into_iter().for_each(|(_, count)| *count = jobs);
        }
        Ok(counts)
    }

    /// Counts what is kept, and what of it is `owner`'s.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn kept(&self, owner: &str) -> Result<Kept, JobsError> {
        const COUNT: &str = "SELECT COUNT(*), \
             CAST(COALESCE(SUM(CASE WHEN owner = $1 THEN 1 ELSE 0 END), 0) AS BIGINT), \
             CAST(COALESCE(SUM(order_bytes + result_bytes), 0) AS BIGINT), \
             CAST(COALESCE(SUM(CASE WHEN owner = $1 THEN order_bytes + result_bytes \
             ELSE 0 END), 0) AS BIGINT) FROM jobs";
        let Some(row) = self.row(sqlx::query(COUNT).bind(owner.to_owned())).await? else {
            return Ok(Kept::default());
        };
        Ok(Kept {
            jobs: row.try_get(0)?,
            own: row.try_get(1)?,
            bytes: row.try_get(2)?,
            own_bytes: row.try_get(3)?,
        })
    }

    /// The finished job that is missed least: its result was fetched longest ago. Of `owner` only,
    /// where one is named.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn oldest_fetched(&self, owner: Option<&str>) -> Result<Option<Uuid>, JobsError> {
        const FIND: &str = "SELECT id FROM jobs WHERE fetched_at IS NOT NULL \
             AND (owner = $1 OR $1 = '') ORDER BY fetched_at LIMIT 1";
        let find = sqlx::query(FIND).bind(owner.unwrap_or_default().to_owned());
        Ok(self.row(find).await?.as_ref().and_then(id_of))
    }

    /// When the result that has been kept for longest was finished; of `owner` only, where one is
    /// named.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn oldest_finished(&self, owner: Option<&str>) -> Result<Option<Millis>, JobsError> {
        const FIND: &str = "SELECT MIN(finished_at) FROM jobs WHERE (owner = $1 OR $1 = '')";
        let find = sqlx::query(FIND).bind(owner.unwrap_or_default().to_owned());
        self.row(find).await?.map_or(Ok(None), |row| Ok(row.try_get(0)?))
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

    /// Ids of jobs that finished before a time, some of them.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn finished_before(&self, time: Millis) -> Result<Vec<Uuid>, JobsError> {
        let find = "SELECT id FROM jobs WHERE finished_at < $1 LIMIT 1000";
        let rows = self.rows(sqlx::query(find).bind(time)).await?;
        Ok(rows.iter().filter_map(id_of).collect())
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

fn id_of(row: &AnyRow) -> Option<Uuid> {
    Uuid::try_parse(&row.try_get::<String, _>(0).ok()?).ok()
}
