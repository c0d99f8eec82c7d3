//! The connection to SQLite or PostgreSQL, opened when it is first needed.

use std::{
    fmt::Write,
    path::Path,
    time::{Duration, Instant},
};

use sqlx::{
    Any, AnyConnection, ConnectOptions, Connection, Executor, Pool,
    any::{AnyConnectOptions, AnyPoolOptions},
};
use tokio::sync::OnceCell;

use super::{JobsError, kind::Kind, schema};

/// How long a statement waits for a connection before it has failed.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long to wait before a locked file is tried again.
const BETWEEN_TRIES: Duration = Duration::from_millis(20);

/// A database that is connected to, and whose tables are made, at the first use.
#[derive(Debug)]
pub(crate) struct Database {
    pub(crate) kind: Kind,
    url: String,
    connections: u32,
    in_memory: bool,
    pool: OnceCell<Pool<Any>>,
}

impl Database {
    /// SQLite in memory: nothing is kept beyond this value.
    pub(crate) fn in_memory() -> Self {
        let url = "sqlite::memory:".to_owned();
        Self {
            kind: Kind::Sqlite,
            url,
            // Each connection has a database of its own.
            connections: 1,
            in_memory: true,
            pool: OnceCell::new(),
        }
    }

    /// SQLite in a file, made where there is none.
    pub(crate) fn in_file(file: &Path) -> Self {
        let url = format!("sqlite://{}?mode=rwc", percent_encoded(file));
        Self { kind: Kind::Sqlite, url, connections: 4, in_memory: false, pool: OnceCell::new() }
    }

    /// The database of a URL: `postgres://user:password@host/name`, or `sqlite://file`.
    ///
    /// # Errors
    /// [`JobsError::Address`] for any other.
    pub(crate) fn at_url(url: &str) -> Result<Self, JobsError> {
        let refuse =
            |problem: String| JobsError::Address { address: without_password(url), problem };
        if let Some(file) = url.strip_prefix("sqlite://") {
            return Ok(Self::in_file(Path::new(file)));
        }
        if !url.starts_with("postgres://") && !url.starts_with("postgresql://") {
            let accepted = "give postgres://USER:PASSWORD@HOST/NAME or sqlite://FILE";
            return Err(refuse(accepted.to_owned()));
        }
        url.parse::<AnyConnectOptions>().map_err(|error| refuse(error.to_string()))?;
        Ok(Self {
            kind: Kind::Postgres,
            url: url.to_owned(),
            connections: 8,
            in_memory: false,
            pool: OnceCell::new(),
        })
    }

    /// Connects, and brings the tables up to date, unless that is done.
    pub(crate) async fn pool(&self) -> Result<&Pool<Any>, JobsError> {
        self.pool.get_or_try_init(|| self.open()).await
    }

    /// Connects as often as [`PATIENCE`] allows while another process turns the file to its
    /// journal or cleans that up: SQLite refuses both at once, whatever its busy time-out.
    async fn open(&self) -> Result<Pool<Any>, JobsError> {
        let until = Instant::now() + PATIENCE;
        loop {
            match self.connect().await {
                Err(error) if error.is_locked() && Instant::now() < until => {
                    tokio::time::sleep(BETWEEN_TRIES).await;
                }
                opened => return opened,
            }
        }
    }

    async fn connect(&self) -> Result<Pool<Any>, JobsError> {
        sqlx::any::install_default_drivers();
        let options: AnyConnectOptions = self.url.parse()?;
        let options = options.disable_statement_logging();
        let sqlite = self.kind == Kind::Sqlite;
        // A pool would try a file that is no database again and again. Open until the end, since
        // the last connection that is closed locks the file to clean up.
        let mut first = None;
        if sqlite && !self.in_memory {
            let mut connection = AnyConnection::connect_with(&options).await?;
            connection.execute(PRAGMAS).await?;
            first = Some(connection);
        }
        let mut pool =
            AnyPoolOptions::new().max_connections(self.connections).acquire_timeout(PATIENCE);
        if self.in_memory {
            pool = pool.idle_timeout(None).max_lifetime(None).test_before_acquire(false);
        }
        let pool = pool.after_connect(move |connection, _| {
            Box::pin(async move {
                connection.execute(if sqlite { PRAGMAS } else { SETTINGS }).await?;
                Ok(())
            })
        });
        let pool = pool.connect_with(options).await?;
        schema::migrate(&pool, self.kind).await?;
        if let Some(first) = first {
            first.close().await?;
        }
        Ok(pool)
    }
}

/// Readers do not wait for the writer, other processes wait for this one, and what was acknowledged
/// survives a loss of power.
const PRAGMAS: &str =
    "PRAGMA busy_timeout = 5000; PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL;";

/// What is looked for is found by an index, whatever PostgreSQL believes of a table that was empty
/// when it was analysed; and planning or compiling a statement again takes longer than running it.
const SETTINGS: &str = "SET enable_seqscan = off; SET jit = off; \
     SET plan_cache_mode = force_generic_plan;";

/// A path as part of a URL.
fn percent_encoded(path: &Path) -> String {
    let mut text = String::new();
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'-' | b'_' | b'.' => {
                text.push(char::from(*byte));
            }
            // Writing to a string does not fail.
            other => drop(write!(text, "%{other:02X}")),
        }
    }
    text
}

/// A URL as it may be shown.
pub(crate) fn without_password(url: &str) -> String {
    match url.split_once("://").zip(url.rsplit_once('@')) {
        Some(((scheme, _), (_, host))) => format!("{scheme}://..@{host}"),
        None => url.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_not_shown() {
        assert_eq!(without_password("postgres://me:secret@host/name"), "postgres://..@host/name");
        assert_eq!(without_password("s3://bucket"), "s3://bucket");
        let refused = Database::at_url("mysql://me:secret@host/name").unwrap_err().to_string();
        assert!(!refused.contains("secret") && refused.contains("postgres://"), "{refused}");
    }

    #[tokio::test]
    async fn a_folder_of_any_name_holds_a_database() {
        let folder = tempfile::tempdir().unwrap();
        let odd = folder.path().join("50% of #1? ä");
        std::fs::create_dir(&odd).unwrap();
        Database::in_file(&odd.join("jobs.sqlite")).pool().await.unwrap();
        assert!(odd.join("jobs.sqlite").exists());
    }
}
