//! The tables, and how older ones become them.

use sqlx::{Any, Connection, Pool, Row, pool::PoolConnection};

use super::{JobsError, kind::Kind};

/// The steps from a version of the schema to the next. All values are integers of 64 bits or texts,
/// so that both databases run the same statements; times are milliseconds since 1970.
const fn steps(kind: Kind) -> [&'static [&'static str]; 5] {
    let counted = match kind {
        Kind::Sqlite => COUNTED_BY_SQLITE,
        Kind::Postgres => COUNTED_BY_POSTGRES,
    };
    [FIRST, CALLBACKS, KEPT, BY_INDEX, counted]
}

const FIRST: &[&str] = &[
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
];

const CALLBACKS: &[&str] = &[
    "ALTER TABLE jobs ADD COLUMN callback_url TEXT",
    "ALTER TABLE jobs ADD COLUMN callback_after BIGINT",
    "ALTER TABLE jobs ADD COLUMN callback_tries BIGINT NOT NULL DEFAULT 0",
    "CREATE INDEX jobs_callbacks ON jobs (callback_after)",
];

const KEPT: &[&str] = &["CREATE INDEX jobs_kept ON jobs (owner, order_bytes, result_bytes)"];

/// Whatever is looked for among jobs is found by an index, however many there are. `run_after` is 0
/// for jobs that may begin: those wait in line.
const BY_INDEX: &[&str] = &[
    "DROP INDEX jobs_next",
    "DROP INDEX jobs_owner",
    "DROP INDEX jobs_content",
    "DROP INDEX jobs_kept",
    "UPDATE jobs SET run_after = 0 WHERE state <> 'queued' OR faults = 0",
    "CREATE INDEX jobs_line ON jobs (model, priority DESC, created_at, id, owner, expires_at) \
     WHERE state = 'queued' AND run_after = 0",
    // An expression, so that no planner takes an index of owners that has finished jobs as well.
    "CREATE INDEX jobs_lane ON jobs ((model || '|' || owner), priority DESC, created_at, id, \
     expires_at) WHERE state = 'queued' AND run_after = 0",
    "CREATE INDEX jobs_later ON jobs (run_after) WHERE state = 'queued' AND run_after > 0",
    "CREATE INDEX jobs_expiring ON jobs (expires_at) \
     WHERE state = 'queued' AND expires_at IS NOT NULL",
    "CREATE INDEX jobs_running ON jobs (owner, lease_until) WHERE state = 'running'",
    "CREATE INDEX jobs_listed ON jobs (owner, created_at, id)",
    "CREATE INDEX jobs_listed_by_state ON jobs (owner, state, created_at, id)",
    "CREATE INDEX jobs_result ON jobs (content_key, finished_at) WHERE state = 'done'",
    "CREATE INDEX jobs_finished_own ON jobs (owner, finished_at) WHERE finished_at IS NOT NULL",
    "CREATE INDEX jobs_fetched ON jobs (fetched_at) WHERE fetched_at IS NOT NULL",
    "CREATE INDEX jobs_fetched_own ON jobs (owner, fetched_at) WHERE fetched_at IS NOT NULL",
];

/// What is kept of each owner is counted by the database itself: also what replicas of an older
/// release and administrators write. No statement changes the bytes of several jobs, so that none
/// waits for another's owner while it holds one.
const COUNTED_BY_SQLITE: &[&str] = &[
    OWNERS,
    "CREATE TRIGGER jobs_more AFTER INSERT ON jobs BEGIN \
     INSERT INTO job_owners VALUES (NEW.owner, 1, NEW.order_bytes + NEW.result_bytes) \
     ON CONFLICT (owner) DO UPDATE SET jobs = jobs + 1, bytes = bytes + excluded.bytes; END",
    "CREATE TRIGGER jobs_resized AFTER UPDATE OF order_bytes, result_bytes ON jobs BEGIN \
     UPDATE job_owners SET bytes = bytes + NEW.order_bytes + NEW.result_bytes \
     - OLD.order_bytes - OLD.result_bytes WHERE owner = OLD.owner; END",
    "CREATE TRIGGER jobs_less AFTER DELETE ON jobs BEGIN \
     UPDATE job_owners SET jobs = jobs - 1, bytes = bytes - OLD.order_bytes - OLD.result_bytes \
     WHERE owner = OLD.owner; \
     DELETE FROM job_owners WHERE owner = OLD.owner AND jobs = 0; END",
    FILL_OWNERS,
];

/// Whole statements are counted where they can be: a thousand changes of one row in a transaction
/// would each step over those before.
const COUNTED_BY_POSTGRES: &[&str] = &[
    OWNERS,
    "CREATE FUNCTION count_jobs_of_owners() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN \
     IF TG_OP = 'INSERT' THEN \
     INSERT INTO job_owners AS o SELECT owner, COUNT(*), SUM(order_bytes + result_bytes) \
     FROM added GROUP BY owner ORDER BY owner \
     ON CONFLICT (owner) DO UPDATE SET jobs = o.jobs + EXCLUDED.jobs, \
     bytes = o.bytes + EXCLUDED.bytes; \
     ELSIF TG_OP = 'UPDATE' THEN \
     UPDATE job_owners SET bytes = bytes + NEW.order_bytes + NEW.result_bytes \
     - OLD.order_bytes - OLD.result_bytes WHERE owner = OLD.owner; \
     ELSE \
     UPDATE job_owners o SET jobs = o.jobs - gone.jobs, bytes = o.bytes - gone.bytes FROM (\
     SELECT owner, COUNT(*) AS jobs, SUM(order_bytes + result_bytes) AS bytes \
     FROM removed GROUP BY owner) gone WHERE o.owner = gone.owner; \
     DELETE FROM job_owners WHERE jobs = 0 AND owner IN (SELECT owner FROM removed); \
     END IF; RETURN NULL; END $$",
    "CREATE TRIGGER jobs_more AFTER INSERT ON jobs REFERENCING NEW TABLE AS added \
     FOR EACH STATEMENT EXECUTE FUNCTION count_jobs_of_owners()",
    "CREATE TRIGGER jobs_resized AFTER UPDATE OF order_bytes, result_bytes ON jobs \
     FOR EACH ROW EXECUTE FUNCTION count_jobs_of_owners()",
    "CREATE TRIGGER jobs_less AFTER DELETE ON jobs REFERENCING OLD TABLE AS removed \
     FOR EACH STATEMENT EXECUTE FUNCTION count_jobs_of_owners()",
    FILL_OWNERS,
];

const OWNERS: &str = "CREATE TABLE job_owners (\
     owner TEXT PRIMARY KEY, jobs BIGINT NOT NULL, bytes BIGINT NOT NULL)";

const FILL_OWNERS: &str = "INSERT INTO job_owners \
     SELECT owner, COUNT(*), CAST(SUM(order_bytes + result_bytes) AS BIGINT) FROM jobs \
     GROUP BY owner";

/// The version that this release reads and writes.
pub const SCHEMA: i64 = steps(Kind::Sqlite).len() as i64;

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
    let steps = steps(kind);
    let Some(missing) = usize::try_from(found).ok().and_then(|found| steps.get(found..)) else {
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
pub(crate) fn first_steps(kind: Kind, versions: usize) -> impl Iterator<Item = &'static str> {
    steps(kind).into_iter().take(versions).flatten().copied()
}
