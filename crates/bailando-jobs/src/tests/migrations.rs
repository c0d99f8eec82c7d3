use std::{sync::Arc, time::Duration};

use bailando_testkit::postgres::Postgres;
use sqlx::{Connection, Executor};

use crate::{
    Inserted, JobTable, JobsError, Kept, NewJob, SCHEMA, State, database::Database, kind::Kind,
    schema::first_steps,
};

/// As the first release of these tables left them, with a job.
const OLD_JOB: &str = "INSERT INTO jobs VALUES ('67e55044-10b1-426f-9247-bb680e5fe0c8', 'me', 'r', \
    'queued', 1, 2, 3, NULL, NULL, NULL, NULL, 0, 0, NULL, NULL, NULL, 0, 0, 'm', 'c', NULL, '{}', \
    5, NULL, 0, NULL)";

/// Put back by the release before this one, for now, and to be taken at once.
const LATER_JOBS: &str = "INSERT INTO jobs VALUES \
    ('67e55044-10b1-426f-9247-bb680e5fe0c9', 'me', 'r', 'queued', 9, 2, 3, NULL, NULL, NULL, NULL, \
    1, 1, NULL, NULL, NULL, 0, 0, 'm', 'c', NULL, '{}', 6, NULL, 0, NULL), \
    ('67e55044-10b1-426f-9247-bb680e5fe0ca', 'you', 'r', 'done', 9, 2, 3, NULL, 2, 4, NULL, \
    1, 0, NULL, NULL, NULL, 0, 0, 'm', 'c', NULL, '{}', 7, '{}', 70, NULL)";

async fn older(url: &str) {
    sqlx::any::install_default_drivers();
    let pool = sqlx::Pool::<sqlx::Any>::connect(url).await.unwrap();
    let kind = if url.starts_with("sqlite") { Kind::Sqlite } else { Kind::Postgres };
    for statement in first_steps(kind, 1) {
        sqlx::query(statement).execute(&pool).await.unwrap();
    }
    sqlx::query(OLD_JOB).execute(&pool).await.unwrap();
    sqlx::query(LATER_JOBS).execute(&pool).await.unwrap();
    sqlx::query("CREATE TABLE job_schema (version BIGINT NOT NULL)").execute(&pool).await.unwrap();
    sqlx::query("INSERT INTO job_schema VALUES (1)").execute(&pool).await.unwrap();
    pool.close().await;
}

/// Replicas that start together bring the tables up to date once, and lose nothing.
async fn brought_up_to_date(url: &str) {
    older(url).await;
    let tables: Vec<_> = (0..4).map(|_| Arc::new(JobTable::at_url(url).unwrap())).collect();
    let opened = tables.iter().map(|table| {
        let table = Arc::clone(table);
        tokio::spawn(async move { table.open().await })
    });
    for opened in opened.collect::<Vec<_>>() {
        opened.await.unwrap().unwrap();
    }
    let old = "67e55044-10b1-426f-9247-bb680e5fe0c8".parse().unwrap();
    let job = tables[0].find(old).await.unwrap().unwrap();
    assert_eq!((job.state, job.order_bytes, job.callback_url), (State::Queued, 5, None));
    let url = Some("https://example.org".to_owned());
    let new = NewJob { callback_url: url, ..NewJob::new("me", "{}") };
    assert_eq!(tables[1].insert(new).await.unwrap(), Inserted::New);
    let kept = tables[2].kept("me").await.unwrap();
    assert_eq!(kept, Kept { jobs: 4, own: 3, bytes: 5 + 6 + 77 + 2, own_bytes: 5 + 6 + 2 });
    let mut taken = Vec::new();
    while let Some(lease) = tables[3].claim(&super::claim(super::LONG)).await.unwrap() {
        taken.push(lease.job.priority);
    }
    assert_eq!(taken, [9, 1, 0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn older_tables_are_brought_up_to_date() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.sqlite");
    std::fs::File::create(&file).unwrap();
    brought_up_to_date(&format!("sqlite://{}", file.display())).await;
    if let Some(postgres) = Postgres::start() {
        brought_up_to_date(&postgres.url()).await;
    }
}

/// Another process turns the file to its journal, or cleans that up, at the same moment.
#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_is_locked_for_a_moment_is_opened_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.sqlite");
    sqlx::any::install_default_drivers();
    let url = format!("sqlite://{}?mode=rwc", file.display());
    let mut other = sqlx::AnyConnection::connect(&url).await.unwrap();
    other.execute("CREATE TABLE other (id TEXT); BEGIN EXCLUSIVE").await.unwrap();
    let table = JobTable::in_file(&file);
    let opened = tokio::spawn(async move { table.open().await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!opened.is_finished());
    other.execute("COMMIT").await.unwrap();
    opened.await.unwrap().unwrap();
}

#[tokio::test]
async fn tables_of_a_later_release_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.sqlite");
    let database = Database::in_file(&file);
    let later = sqlx::query("UPDATE job_schema SET version = $1").bind(SCHEMA + 1);
    later.execute(database.pool().await.unwrap()).await.unwrap();
    let refused = JobTable::in_file(&file).open().await.unwrap_err();
    assert!(matches!(refused, JobsError::Schema { found, .. } if found == SCHEMA + 1), "{refused}");
}

#[tokio::test]
async fn a_file_that_is_no_database_is_an_error_and_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.sqlite");
    std::fs::write(&file, vec![b'x'; 8192]).unwrap();
    let refused = JobTable::in_file(&file).open().await.unwrap_err().to_string();
    assert!(refused.contains("not a database"), "{refused}");
    assert_eq!(std::fs::read(&file).unwrap(), vec![b'x'; 8192]);
}
