use std::time::Duration;

use super::{LONG, SHORT, claim, find, insert, job, take, with_each};
use crate::{JobTable, LONGEST_WAIT, NewJob, PutBack, now};

const HOUR: i64 = 3_600_000;

/// As a clock that is set back by an hour leaves the table.
async fn an_hour_ago(jobs: &JobTable) {
    let later = "UPDATE jobs SET created_at = created_at + $1, lease_until = lease_until + $1, \
        run_after = CASE WHEN run_after = 0 THEN 0 ELSE run_after + $1 END";
    jobs.change(sqlx::query(later).bind(HOUR)).await.unwrap();
    let later = "UPDATE workers SET seen_at = seen_at + $1";
    jobs.change(sqlx::query(later).bind(HOUR)).await.unwrap();
}

/// Whose worker died, whose wait was not over, and which another worker's model was to do.
#[test]
fn no_job_waits_until_a_clock_that_was_set_back_has_caught_up() {
    with_each(async |jobs| {
        let lost = insert(&jobs, job("me")).await;
        assert!(take(&jobs).await.is_some());
        let again = insert(&jobs, job("me")).await;
        let lease = take(&jobs).await.unwrap();
        assert!(jobs.put_back(&lease, PutBack::Retry(SHORT)).await.unwrap());
        let foreign = NewJob { model: "another".to_owned(), ..job("me") };
        let foreign = insert(&jobs, foreign).await;
        jobs.alive(uuid::Uuid::new_v4(), "another").await.unwrap();
        an_hour_ago(&jobs).await;
        assert_eq!(take(&jobs).await.unwrap().job.id, foreign);
        assert!(take(&jobs).await.is_none());
        let lease = Duration::from_secs(1);
        jobs.line_up(lease).await.unwrap();
        assert_eq!(take(&jobs).await.unwrap().job.id, again);
        tokio::time::sleep(lease).await;
        assert_eq!(take(&jobs).await.unwrap().job.id, lost);
    });
}

/// Clocks of replicas differ by a little.
#[test]
fn waits_and_leases_of_now_are_left_alone() {
    with_each(async |jobs| {
        let id = insert(&jobs, job("me")).await;
        let lease = take(&jobs).await.unwrap();
        assert!(jobs.put_back(&lease, PutBack::Retry(LONGEST_WAIT * 9)).await.unwrap());
        let until = find(&jobs, id).await.run_after;
        assert!(until <= now() + i64::try_from(LONGEST_WAIT.as_millis()).unwrap(), "{until}");
        let other = insert(&jobs, job("me")).await;
        assert_eq!(jobs.claim(&claim(LONG)).await.unwrap().unwrap().job.id, other);
        jobs.line_up(LONG - Duration::from_secs(5)).await.unwrap();
        assert!(take(&jobs).await.is_none());
        assert_eq!(find(&jobs, id).await.run_after, until);
    });
}

/// The whole wait is in the line then, and a claim need not look for it.
#[test]
fn a_job_whose_wait_is_over_stands_in_line() {
    with_each(async |jobs| {
        let id = insert(&jobs, job("me")).await;
        let lease = take(&jobs).await.unwrap();
        let wait = Duration::from_secs(1);
        jobs.put_back(&lease, PutBack::Retry(wait)).await.unwrap();
        jobs.line_up(LONG).await.unwrap();
        assert!(find(&jobs, id).await.run_after > 0);
        tokio::time::sleep(wait).await;
        jobs.line_up(LONG).await.unwrap();
        assert_eq!(find(&jobs, id).await.run_after, 0);
        assert_eq!(take(&jobs).await.unwrap().job.id, id);
    });
}
