//! How much is kept, and what makes room.

use sqlx::{Row, any::AnyRow};
use uuid::Uuid;

use super::{JobTable, JobsError, Millis, State};

/// How many jobs are kept, and of whom.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Jobs in all.
    pub jobs: i64,
    /// Jobs of the owner that was asked about.
    pub own: i64,
    /// Bytes of all orders, songs and results, those that are expected included.
    pub bytes: i64,
    /// Bytes of those of the owner that was asked about.
    pub own_bytes: i64,
}

/// What is kept of all owners, and of $1: as the database has counted it, not the jobs themselves.
pub(crate) const KEPT: &str = "SELECT CAST(COALESCE(SUM(jobs), 0) AS BIGINT), \
     CAST(COALESCE(SUM(CASE WHEN owner = $1 THEN jobs ELSE 0 END), 0) AS BIGINT), \
     CAST(COALESCE(SUM(bytes), 0) AS BIGINT), \
     CAST(COALESCE(SUM(CASE WHEN owner = $1 THEN bytes ELSE 0 END), 0) AS BIGINT) FROM job_owners";

pub(crate) const OLDEST_FETCHED: &str =
    "SELECT id FROM jobs WHERE fetched_at IS NOT NULL ORDER BY fetched_at LIMIT 1";
pub(crate) const OLDEST_FETCHED_OWN: &str =
    "SELECT id FROM jobs WHERE owner = $1 AND fetched_at IS NOT NULL ORDER BY fetched_at LIMIT 1";
pub(crate) const FINISHED: &str =
    "SELECT id FROM jobs WHERE finished_at < $1 ORDER BY finished_at LIMIT 1";
pub(crate) const FINISHED_OWN: &str =
    "SELECT id FROM jobs WHERE owner = $1 AND finished_at < $2 ORDER BY finished_at LIMIT 1";
pub(crate) const OLDEST_FINISHED: &str = "SELECT MIN(finished_at) FROM jobs";
pub(crate) const OLDEST_FINISHED_OWN: &str =
    "SELECT MIN(finished_at) FROM jobs WHERE owner = $1 AND finished_at IS NOT NULL";

impl JobTable {
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
        let Some(row) = self.row(sqlx::query(KEPT).bind(owner.to_owned())).await? else {
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
        let find = match owner {
            Some(owner) => sqlx::query(OLDEST_FETCHED_OWN).bind(owner.to_owned()),
            None => sqlx::query(OLDEST_FETCHED),
        };
        Ok(self.row(find).await?.as_ref().and_then(id_of))
    }

    /// When the result that has been kept for longest was finished; of `owner` only, where one is
    /// named.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn oldest_finished(&self, owner: Option<&str>) -> Result<Option<Millis>, JobsError> {
        let find = match owner {
            Some(owner) => sqlx::query(OLDEST_FINISHED_OWN).bind(owner.to_owned()),
            None => sqlx::query(OLDEST_FINISHED),
        };
        self.row(find).await?.map_or(Ok(None), |row| Ok(row.try_get(0)?))
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

    /// One of the jobs that finished before a time; of `owner` only, where one is named.
    ///
    /// # Errors
    /// [`JobsError::Database`].
    pub async fn one_finished_before(
        &self,
        time: Millis,
        owner: Option<&str>,
    ) -> Result<Option<Uuid>, JobsError> {
        let find = match owner {
            Some(owner) => sqlx::query(FINISHED_OWN).bind(owner.to_owned()).bind(time),
            None => sqlx::query(FINISHED).bind(time),
        };
        Ok(self.row(find).await?.as_ref().and_then(id_of))
    }
}

fn id_of(row: &AnyRow) -> Option<Uuid> {
    Uuid::try_parse(&row.try_get::<String, _>(0).ok()?).ok()
}
