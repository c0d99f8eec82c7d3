//! Nothing that is asked for each job or request reads all jobs: by the plans of the databases, for
//! times say little about a small table.

use bailando_testkit::postgres::Postgres;
use sqlx::{AssertSqlSafe, Executor, Row};

use super::{insert, job};
use crate::{
    JobTable,
    claims::NEXT,
    room::{
        FINISHED, FINISHED_OWN, KEPT, OLDEST_FETCHED, OLDEST_FETCHED_OWN, OLDEST_FINISHED,
        OLDEST_FINISHED_OWN,
    },
    sweeps::{ABANDONED, CUT, EXPIRED, LINE_UP},
    table::{FIND_RESULT, LIST, LIST_STATE},
};

/// Statements, and what finds their jobs.
const FOUND_BY: [(&str, &[&str]); 17] = [
    (NEXT, &["jobs_line", "jobs_lane", "jobs_later", "jobs_running", "jobs_listed_by_state", "id"]),
    (LIST, &["jobs_listed"]),
    (LIST_STATE, &["jobs_listed_by_state"]),
    (FIND_RESULT, &["jobs_result"]),
    (KEPT, &[]),
    (OLDEST_FETCHED, &["jobs_fetched"]),
    (OLDEST_FETCHED_OWN, &["jobs_fetched_own"]),
    (FINISHED, &["jobs_finished"]),
    (FINISHED_OWN, &["jobs_finished_own"]),
    (OLDEST_FINISHED, &["jobs_finished"]),
    (OLDEST_FINISHED_OWN, &["jobs_finished_own"]),
    (EXPIRED.0, &["jobs_expiring"]),
    (EXPIRED.1, &["id"]),
    (ABANDONED.0, &["jobs_running"]),
    (ABANDONED.1, &["id"]),
    (LINE_UP, &["jobs_later", "id"]),
    (CUT, &["jobs_running"]),
];

/// A value for each parameter of a statement.
fn values(statement: &str) -> Vec<&'static str> {
    let known = |number: &usize| statement.contains(&format!("${number}"));
    (1..9).take_while(known).map(|_| "'4000000000000'").collect()
}

/// Of SQLite, which plans without a look at values.
async fn plan(jobs: &JobTable, statement: &str) -> Vec<String> {
    let explain = AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}"));
    let values = values(statement);
    let query = values.iter().fold(sqlx::query(explain), |query, value| query.bind(*value));
    let rows = jobs.rows(query).await.unwrap();
    rows.iter().map(|row| row.try_get(3).unwrap()).collect()
}

/// Of PostgreSQL, as our connections have it plan: without a look at values, too.
async fn plan_of_postgres(jobs: &JobTable, statement: &str) -> Vec<String> {
    let mut connection = jobs.database.pool().await.unwrap().acquire().await.unwrap();
    let prepare = AssertSqlSafe(format!("PREPARE planned AS {statement}"));
    connection.execute(prepare).await.unwrap();
    let values = values(statement).join(", ");
    let values = if values.is_empty() { values } else { format!("({values})") };
    let explain = format!("EXPLAIN EXECUTE planned {values}");
    let rows = connection.fetch_all(AssertSqlSafe(explain)).await.unwrap();
    connection.execute("DEALLOCATE planned").await.unwrap();
    rows.iter().map(|row| row.try_get(0).unwrap()).collect()
}

/// Three hundred jobs of thirty owners that wait or are done, as the database's own figures say. Of
/// a single owner, an index without owners would be as good as one with them.
async fn analysed(jobs: &JobTable) {
    for number in 0..300 {
        insert(jobs, job(&format!("owner {}", number % 30))).await;
    }
    let done = "UPDATE jobs SET state = 'done', finished_at = created_at, \
        fetched_at = created_at WHERE id < '8'";
    jobs.change(sqlx::query(done)).await.unwrap();
    jobs.change(sqlx::query("ANALYZE")).await.unwrap();
}

#[tokio::test]
async fn sqlite_reads_no_more_jobs_than_it_needs() {
    let jobs = JobTable::in_memory();
    jobs.open().await.unwrap();
    for round in 0..2 {
        if round == 1 {
            analysed(&jobs).await;
        }
        for (statement, found_by) in FOUND_BY {
            let plan = plan(&jobs, statement).await;
            let reads = |line: &&String| {
                let mut words = line.split(' ');
                let (how, what) = (words.next(), words.next());
                matches!(how, Some("SCAN" | "SEARCH" | "BLOOM"))
                    && matches!(what, Some("jobs" | "j" | "b" | "FILTER"))
            };
            for line in plan.iter().filter(reads) {
                let by = line.split_once("INDEX ").map_or("", |(_, by)| by);
                let by = by.split(' ').next().unwrap_or_default();
                let by = by.replace("sqlite_autoindex_jobs_1", "id");
                assert!(found_by.contains(&&*by), "{line} of {statement}\n{plan:#?}");
            }
            // Of a claim: at most the first hundred of the line, and the first of each owner.
            let sorts = plan.iter().filter(|line| line.contains("TEMP B-TREE")).count();
            let most = if statement == NEXT { 2 } else { 0 };
            assert!(sorts <= most, "{statement}\n{plan:#?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn postgres_reads_no_more_jobs_than_it_needs() {
    let Some(postgres) = tokio::task::block_in_place(Postgres::start) else { return };
    let jobs = JobTable::at_url(&postgres.url()).unwrap();
    jobs.open().await.unwrap();
    // As it is planned for a table that was never analysed, and for one that was.
    for round in 0..2 {
        if round == 1 {
            analysed(&jobs).await;
        }
        for (statement, found_by) in FOUND_BY {
            let plan = plan_of_postgres(&jobs, statement).await;
            let of_jobs = |line: &&String| line.contains("Scan") && line.contains(" on jobs");
            let by_bitmap = |line: &&String| line.contains("Bitmap Heap Scan");
            for line in plan.iter().filter(of_jobs).filter(|line| !by_bitmap(line)) {
                let by = line.split_once(" using ").or(line.split_once("Index Scan on "));
                let by = by.map_or("", |(_, by)| by);
                let by = by.split(' ').next().unwrap_or_default().replace("jobs_pkey", "id");
                assert!(found_by.contains(&&*by), "{line} of {statement}\n{plan:#?}");
            }
        }
    }
}
