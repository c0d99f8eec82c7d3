//! What the table of jobs costs as it grows: milliseconds of a claim, an order, a page of a list
//! and a scrape, in SQLite and in PostgreSQL where that is installed, beside so many jobs.
//!
//! ```sh
//! cargo run --release -p bailando-jobs --example many
//! ```

#![expect(clippy::print_stdout, reason = "a table for the terminal")]

use std::time::{Duration, Instant};

use bailando_jobs::{Claim, JobTable, Listing, NewJob, Reached, State};
use bailando_testkit::postgres::Postgres;
use sqlx::{Any, Pool};

type Outcome<T = ()> = Result<T, Box<dyn std::error::Error>>;

/// How often each is measured. The least is told: what is longer is of the machine.
const TIMES: usize = 21;

/// Jobs that are there beforehand.
struct Case {
    name: &'static str,
    jobs: i64,
    owners: i64,
    state: &'static str,
    /// Milliseconds since 1970 at which they may begin.
    run_after: i64,
}

/// In a thousand years.
const NOT_YET: i64 = 33_000_000_000_000;

const CASES: [Case; 8] = [
    Case { name: "500 wait", jobs: 500, owners: 1, state: "queued", run_after: 0 },
    Case { name: "10,000 wait", jobs: 10_000, owners: 1, state: "queued", run_after: 0 },
    Case { name: "100,000 wait", jobs: 100_000, owners: 1, state: "queued", run_after: 0 },
    Case {
        name: ".. of 1,000 owners",
        jobs: 100_000,
        owners: 1_000,
        state: "queued",
        run_after: 0,
    },
    Case {
        name: ".. of 1,000, all at work",
        jobs: 100_000,
        owners: 1_000,
        state: "queued",
        run_after: 0,
    },
    Case { name: ".. of 100,000", jobs: 100_000, owners: 100_000, state: "queued", run_after: 0 },
    Case {
        name: "100,000 wait to be tried again",
        jobs: 100_000,
        owners: 1,
        state: "queued",
        run_after: NOT_YET,
    },
    Case { name: "100,000 are done", jobs: 100_000, owners: 1_000, state: "done", run_after: 0 },
];

/// Jobs of one statement; $1 how many, $2 of how many owners, $3 their state, $4 their wait.
const FILL: &str = "INSERT INTO jobs (id, owner, request_id, state, priority, created_at, \
     run_after, finished_at, starts, faults, codes_done, codes_total, model, content_key, \
     order_json, order_bytes, result_bytes) WITH RECURSIVE numbers (n) AS (\
     SELECT CAST(1 AS BIGINT) UNION ALL SELECT n + 1 FROM numbers WHERE n < $1) \
     SELECT '00000000-0000-4000-8000-' || CAST(100000000000 + n AS TEXT), \
     'of ' || CAST(n % $2 AS TEXT), '', $3, 0, n, $4, \
     CASE WHEN $3 = 'done' THEN CAST(33000000000000 AS BIGINT) END, 0, 0, 0, 0, \
     'model', CAST(n AS TEXT), CAST($5 AS TEXT), 300, 0 FROM numbers";

/// A job at work of every owner.
const AT_WORK: &str = "UPDATE jobs SET state = 'running', lease_until = 33000000000000 \
     WHERE created_at <= 1000";

async fn timed<T>(once: impl Future<Output = Outcome<T>>) -> Outcome<(Duration, T)> {
    let begun = Instant::now();
    let result = once.await?;
    Ok((begun.elapsed(), result))
}

async fn least(mut once: impl AsyncFnMut() -> Outcome<Duration>) -> Outcome<String> {
    let mut least = Duration::MAX;
    for _ in 0..TIMES {
        least = least.min(once().await?);
    }
    Ok(format!("{:.1}", least.as_secs_f64() * 1e3))
}

async fn measure(table: &JobTable, pool: &Pool<Any>, case: &Case) -> Outcome {
    let tidy = if table.is_shared() { "VACUUM ANALYZE" } else { "ANALYZE" };
    sqlx::query("DELETE FROM jobs").execute(pool).await?;
    let fill = sqlx::query(FILL).bind(case.jobs).bind(case.owners).bind(case.state);
    fill.bind(case.run_after).bind("o".repeat(300)).execute(pool).await?;
    if case.name.ends_with("at work") {
        sqlx::query(AT_WORK).execute(pool).await?;
    }
    // As the database itself does sooner or later.
    sqlx::query(tidy).execute(pool).await?;
    let lease = Duration::from_secs(3600);
    let claim = Claim { model: "model", lease, most_starts: 10, full: &[] };
    let claim = async || {
        let (time, lease) = timed(async { Ok(table.claim(&claim).await?) }).await?;
        if let Some(lease) = lease {
            // Its owner is next again.
            table.done(&lease, String::new(), 0, &Reached::default()).await?;
        }
        Ok(time)
    };
    let order = async || {
        let order = async {
            // As the server does: before the body is read, and before it is stored.
            table.kept("of 0").await?;
            table.kept("of 0").await?;
            let order = NewJob { model: "model".to_owned(), ..NewJob::new("of 0", "{}") };
            Ok(table.insert(order).await?)
        };
        Ok(timed(order).await?.0)
    };
    let list = async |state: Option<State>| {
        let owner = "of 0".to_owned();
        let listing = Listing { owner, state, before: None, most: 100, finished_since: 0 };
        Ok(timed(async { Ok(table.list(listing).await?) }).await?.0)
    };
    let (taken, ordered) = (least(claim).await?, least(order).await?);
    let listed = least(async || list(None).await).await?;
    let by_state = least(async || list(Some(State::Failed)).await).await?;
    let scrape = async || Ok(timed(async { Ok(table.count().await?) }).await?.0);
    let scraped = least(scrape).await?;
    println!("| {} | {taken} | {ordered} | {listed} | {by_state} | {scraped} |", case.name);
    Ok(())
}

async fn all(name: &str, url: &str) -> Outcome {
    println!(
        "\n| {name}, ms | claim | order | list | list of failed | scrape |\n\
         |---|---|---|---|---|---|"
    );
    let table = JobTable::at_url(url)?;
    table.open().await?;
    let pool = Pool::<Any>::connect(url).await?;
    for case in &CASES {
        measure(&table, &pool, case).await?;
    }
    Ok(())
}

fn main() -> Outcome {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let folder = tempfile::tempdir()?;
    let file = format!("sqlite://{}", folder.path().join("jobs.sqlite").display());
    runtime.block_on(all("SQLite", &file))?;
    if let Some(postgres) = Postgres::start() {
        runtime.block_on(all("PostgreSQL", &postgres.url()))?;
    }
    Ok(())
}
