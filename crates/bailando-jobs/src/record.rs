//! A job as the table has it.

use std::time::{SystemTime, UNIX_EPOCH};

use sqlx::{Row, any::AnyRow};
use uuid::Uuid;

use super::JobsError;

/// Milliseconds since 1970.
pub type Millis = i64;

/// The time now. Replicas compare times of each other: their clocks must agree to within a part of
/// a lease.
#[must_use]
pub fn now() -> Millis {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Millis::try_from(since.as_millis()).unwrap_or(Millis::MAX)
}

/// What has become of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// It waits for a worker, for the first time or again.
    Queued,
    /// A worker has a lease on it.
    Running,
    /// Its result is stored.
    Done,
    /// It will have no result.
    Failed,
}

impl State {
    /// All states.
    pub const ALL: [Self; 4] = [Self::Queued, Self::Running, Self::Done, Self::Failed];

    /// Its name, as the table and callers have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
        }
    }

    /// The state of a name.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }

    /// Whether nothing more becomes of it.
    #[must_use]
    pub fn is_final(self) -> bool {
        matches!(self, Self::Done | Self::Failed)
    }
}

/// A job to be kept.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// Its id, which also names its files.
    pub id: Uuid,
    /// Who ordered it.
    pub owner: String,
    /// The request that ordered it.
    pub request_id: String,
    /// Jobs of a higher priority begin first.
    pub priority: i64,
    /// When it is no longer wanted if it has not begun.
    pub expires_at: Option<Millis>,
    /// SHA-256 of the model that it was ordered from.
    pub model: String,
    /// Hash of everything that determines the result.
    pub content_key: String,
    /// The caller's name for it: of the same owner there is one job of each.
    pub idempotency_key: Option<String>,
    /// What is wanted, as JSON.
    pub order: String,
    /// Bytes of the stored song.
    pub order_bytes: i64,
    /// Bytes that count for its result until it is done or has failed.
    pub expected_bytes: i64,
    /// The result and its bytes, where there is one already.
    pub result: Option<(String, i64)>,
    /// Where its end is reported to.
    pub callback_url: Option<String>,
}

impl NewJob {
    /// A job of `owner` for `order`, with an id of its own and nothing else.
    #[must_use]
    pub fn new(owner: &str, order: &str) -> Self {
        Self {
            id: Uuid::new_v4(),
            owner: owner.to_owned(),
            request_id: String::new(),
            priority: 0,
            expires_at: None,
            model: String::new(),
            content_key: String::new(),
            idempotency_key: None,
            order: order.to_owned(),
            order_bytes: 0,
            expected_bytes: 0,
            result: None,
            callback_url: None,
        }
    }
}

/// A job as it is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobRecord {
    /// As in [`NewJob`].
    pub id: Uuid,
    /// As in [`NewJob`].
    pub owner: String,
    /// As in [`NewJob`].
    pub request_id: String,
    /// What has become of it.
    pub state: State,
    /// As in [`NewJob`].
    pub priority: i64,
    /// When it was ordered.
    pub created_at: Millis,
    /// When it may begin again; 0 if it may at once.
    pub run_after: Millis,
    /// As in [`NewJob`].
    pub expires_at: Option<Millis>,
    /// When it began, for the last time.
    pub started_at: Option<Millis>,
    /// When it was done, or had failed.
    pub finished_at: Option<Millis>,
    /// When its result was first sent completely.
    pub fetched_at: Option<Millis>,
    /// How often it has begun.
    pub starts: i64,
    /// How often it failed by a fault of the service.
    pub faults: i64,
    /// What is being done.
    pub stage: Option<String>,
    /// Pairs of pose codes that exist.
    pub codes_done: i64,
    /// Pairs of pose codes of the whole dance; 0 while that is not known.
    pub codes_total: i64,
    /// As in [`NewJob`].
    pub model: String,
    /// As in [`NewJob`].
    pub content_key: String,
    /// As in [`NewJob`].
    pub idempotency_key: Option<String>,
    /// As in [`NewJob`].
    pub order: String,
    /// Bytes of the order, and of the song while it is needed.
    pub order_bytes: i64,
    /// The result, as JSON, once it is done.
    pub result: Option<String>,
    /// Bytes of its files, once it is done; before, those that are expected.
    pub result_bytes: i64,
    /// Why it failed, as JSON.
    pub error: Option<String>,
    /// As in [`NewJob`].
    pub callback_url: Option<String>,
    /// How often its end was reported in vain.
    pub callback_tries: i64,
}

impl JobRecord {
    pub(crate) fn read(row: &AnyRow) -> Result<Self, JobsError> {
        let id: String = row.try_get("id")?;
        let broken =
            |problem: &str| JobsError::Record { id: id.clone(), problem: problem.to_owned() };
        let state: String = row.try_get("state")?;
        let count = |name: &str| {
            let value: i64 = row.try_get(name)?;
            match value >= 0 {
                true => Ok(value),
                false => Err(broken(&format!("{name} is {value}"))),
            }
        };
        Ok(Self {
            state: State::of(&state).ok_or_else(|| broken(&format!("state is {state:?}")))?,
            owner: row.try_get("owner")?,
            request_id: row.try_get("request_id")?,
            priority: row.try_get("priority")?,
            created_at: row.try_get("created_at")?,
            run_after: row.try_get("run_after")?,
            expires_at: row.try_get("expires_at")?,
            started_at: row.try_get("started_at")?,
            finished_at: row.try_get("finished_at")?,
            fetched_at: row.try_get("fetched_at")?,
            starts: count("starts")?,
            faults: count("faults")?,
            stage: row.try_get("stage")?,
            codes_done: count("codes_done")?,
            codes_total: count("codes_total")?,
            model: row.try_get("model")?,
            content_key: row.try_get("content_key")?,
            idempotency_key: row.try_get("idempotency_key")?,
            order: row.try_get("order_json")?,
            order_bytes: count("order_bytes")?,
            result: row.try_get("result_json")?,
            result_bytes: count("result_bytes")?,
            error: row.try_get("error_json")?,
            callback_url: row.try_get("callback_url")?,
            callback_tries: count("callback_tries")?,
            id: Uuid::try_parse(&id).map_err(|_| broken("its id is no UUID"))?,
        })
    }
}
