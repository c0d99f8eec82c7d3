//! The tables, and how older ones become them.

use sqlx::{Any, Connection, Pool, Row, pool::PoolConnection};

use super::{JobsError, kind::Kind};

/// One step from a version of the schema to the next. All values are integers of 64 bits or texts,
/// so that both databases run the same statements; times are milliseconds since 1970.
const STEPS: [&[&str]; 3] = [
    &[
        "CREATE TABLE jobs (
            id TEXT PRIMARY KEY,
            owner TEXT NOT NULL,
            request_id TEXT NOT NULL,
            state TEXT NOT NULL,
            priority BIGINT NOT NULL,
            created_at BIGINT NOT NULL,
            run_after BIGINT NOT NULL,
            expires_at BIGINT,
            started_at BIGINT,
            finished_at BIGINT,
            fetched_at BIGINT,
            starts BIGINT NOT NULL,
            faults BIGINT NOT NULL,
            lease TEXT,
            lease_until BIGINT,
            stage TEXT,
            codes_done BIGINT NOT NULL,
            codes_total BIGINT NOT NULL,
            model TEXT NOT NULL,
            content_key TEXT NOT NULL,
            idempotency_key TEXT,
            order_json TEXT NOT NULL,
            order_bytes BIGINT NOT NULL,
            result_json TEXT,
            result_bytes BIGINT NOT NULL,
            error_json TEXT
        )",
        "CREATE UNIQUE INDEX jobs_idempotency ON jobs (owner, idempotency_key)",
        "CREATE INDEX jobs_next ON jobs (state, priority DESC, created_at)",
        "CREATE INDEX jobs_owner ON jobs (owner, created_at)",
        "CREATE INDEX jobs_content ON jobs (content_key)",
        "CREATE INDEX jobs_finished ON jobs (finished_at)",
        "CREATE TABLE workers (id TEXT PRIMARY KEY, model TEXT NOT NULL, seen_at BIGINT NOT NULL)",
    ],
    &[
        "ALTER TABLE jobs ADD COLUMN callback_url TEXT",
        "ALTER TABLE jobs ADD COLUMN callback_after BIGINT",
        "ALTER TABLE jobs ADD COLUMN callback_tries BIGINT NOT NULL DEFAULT 0",
        "CREATE INDEX jobs_callbacks ON jobs (callback_after)",
    ],
    // What is kept is counted with every order, without reading the orders themselves.
    &["CREATE INDEX jobs_kept ON jobs (owner, order_bytes, result_bytes)"],
];

/// The version that this release reads and writes.
pub const SCHEMA: i64 = STEPS.len() as i64;

/// Brings the tables to [`SCHEMA`]. Replicas that start together take turns.
pub(crate) async fn migrate(pool: &Pool<Any>, kind: Kind) -> Result<(), JobsError> {
    let mut connection: PoolConnection<Any> = pool.acquire().await?;
    let mut changes = match kind {
        // Takes the only lock for writing at once, so that it never has to give way to another.
        Kind::Sqlite => connection.begin_with("BEGIN IMMEDIATE").await?,
        Kind::Postgres => {
            let mut changes = connection.begin().await?;
            sqlx::query("SELECT pg_advisory_xact_lock(7217102)").execute(&mut *changes).await?;
            changes
        }
    };
    sqlx::query("CREATE TABLE IF NOT EXISTS job_schema (version BIGINT NOT NULL)")
        .execute(&mut *changes)
        .await?;
    let row = sqlx::query("SELECT CAST(COALESCE(MAX(version), 0) AS BIGINT) FROM job_schema")
        .fetch_one(&mut *changes)
        .await?;
    let found: i64 = row.try_get(0)?;
    let Some(missing) = usize::try_from(found).ok().and_then(|found| STEPS.get(found..)) else {
        return Err(JobsError::Schema { found, known: SCHEMA });
    };
    let statements: Vec<&'static str> =
        missing.iter().flat_map(|step| step.iter().copied()).collect();
    let changed = !statements.is_empty();
    for statement in statements {
        sqlx::query(statement).execute(&mut *changes).await?;
    }
    if changed {
        sqlx::query("DELETE FROM job_schema").execute(&mut *changes).await?;
        sqlx::query("INSERT INTO job_schema (version) VALUES ($1)")
            .bind(SCHEMA)
            .execute(&mut *changes)
            .await?;
    }
    changes.commit().await?;
    Ok(())
}

/// The statements of the first `versions` steps, for tests of older tables.
#[cfg(test)]
pub(crate) fn first_steps(versions: usize) -> impl Iterator<Item = &'static str> {
    STEPS.into_iter().take(versions).flatten().copied()
}
