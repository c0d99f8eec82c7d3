use std::{collections::HashSet, sync::Arc, time::Duration};

use bailando_testkit::postgres::Postgres;
use uuid::Uuid;

use super::{LONG, SHORT, claim, find, insert, job, reached, take, with_each};
use crate::{
    Claim, Inserted, JobRecord, JobTable, JobsError, Kept, Listing, NewJob, PutBack, State, now,
};

#[test]
fn a_job_is_kept_worked_on_and_done() {
    with_each(async |jobs| {
        let order = NewJob { priority: 2, order_bytes: 7, ..job("me") };
        let id = insert(&jobs, order.clone()).await;
        let kept = find(&jobs, id).await;
        assert_eq!((kept.state, kept.starts, kept.priority), (State::Queued, 0, 2));
        assert_eq!((&kept.order, kept.order_bytes), (&order.order, 7 + 2));
        let lease = take(&jobs).await.unwrap();
        assert_eq!((lease.job.id, lease.job.state), (id, State::Running));
        assert!(take(&jobs).await.is_none());
        assert!(jobs.renew(&lease, LONG, &reached(4)).await.unwrap());
        let running = find(&jobs, id).await;
        assert_eq!((running.codes_done, running.codes_total, running.starts), (4, 9, 1));
        assert_eq!(running.stage.as_deref(), Some("inference"));
        assert!(jobs.done(&lease, "[1]".to_owned(), 5, &reached(9)).await.unwrap());
        let done = find(&jobs, id).await;
        assert_eq!((done.state, done.result.as_deref()), (State::Done, Some("[1]")));
        assert!(done.finished_at >= done.started_at && done.started_at >= Some(done.created_at));
        let kept = jobs.kept("me").await.unwrap();
        // The order takes two bytes, the result five.
        assert_eq!(kept, Kept { jobs: 1, own: 1, bytes: 7, own_bytes: 7 });
        let others = jobs.kept("you").await.unwrap();
        assert_eq!(others, Kept { jobs: 1, own: 0, bytes: 7, own_bytes: 0 });
        let (order, result) = (String::new(), Some(String::new()));
        assert_eq!(jobs.look(id).await.unwrap(), Some(JobRecord { order, result, ..done }));
        assert!(!jobs.renew(&lease, LONG, &reached(9)).await.unwrap(), "the lease has ended");
        assert!(jobs.delete(id).await.unwrap() && !jobs.delete(id).await.unwrap());
    });
}

#[test]
fn another_worker_takes_a_job_whose_lease_has_ended_and_the_first_changes_nothing_more() {
    with_each(async |jobs| {
        let id = insert(&jobs, job("me")).await;
        let first = take(&jobs).await.unwrap();
        assert!(take(&jobs).await.is_none());
        assert!(jobs.renew(&first, SHORT, &reached(0)).await.unwrap());
        tokio::time::sleep(SHORT * 2).await;
        let second = take(&jobs).await.unwrap();
        assert_eq!((second.job.id, second.job.starts), (id, 2));
        assert!(!jobs.renew(&first, LONG, &reached(1)).await.unwrap());
        assert!(!jobs.done(&first, "first".to_owned(), 0, &reached(9)).await.unwrap());
        assert!(!jobs.fail(&first, "first".to_owned()).await.unwrap());
        for why in [PutBack::Retry(SHORT), PutBack::Postpone(SHORT), PutBack::Release] {
            assert!(!jobs.put_back(&first, why).await.unwrap());
        }
        assert!(jobs.done(&second, "second".to_owned(), 0, &reached(9)).await.unwrap());
        assert_eq!(find(&jobs, id).await.result.as_deref(), Some("second"));
    });
}

#[test]
fn a_job_that_no_worker_survives_fails_at_last() {
    with_each(async |jobs| {
        let id = insert(&jobs, job("me")).await;
        for _ in 0..3 {
            assert!(jobs.claim(&claim(SHORT)).await.unwrap().is_some());
            tokio::time::sleep(SHORT * 2).await;
        }
        assert!(take(&jobs).await.is_none());
        let say = |text: &str| text.to_owned();
        jobs.fail_hopeless(3, say("expired"), say("abandoned")).await.unwrap();
        let failed = find(&jobs, id).await;
        assert_eq!((failed.state, failed.error.as_deref()), (State::Failed, Some("abandoned")));
    });
}

/// What becomes of it needs them no more, whatever that is.
#[test]
fn the_bytes_of_a_result_count_from_the_order_on() {
    with_each(async |jobs| {
        let order = || NewJob { order_bytes: 7, expected_bytes: 100, ..job("me") };
        let bytes = async || jobs.kept("me").await.unwrap().bytes;
        let say = |text: &str| text.to_owned();
        for done in [true, false] {
            let id = insert(&jobs, order()).await;
            assert_eq!(bytes().await, 2 + 7 + 100);
            let lease = take(&jobs).await.unwrap();
            assert!(jobs.put_back(&lease, PutBack::Release).await.unwrap());
            let lease = take(&jobs).await.unwrap();
            assert_eq!(bytes().await, 2 + 7 + 100);
            if done {
                assert!(jobs.done(&lease, say("{}"), 5, &reached(9)).await.unwrap());
            } else {
                assert!(jobs.fail(&lease, say("{}")).await.unwrap());
            }
            assert_eq!(bytes().await, if done { 2 + 5 } else { 2 });
            assert!(jobs.delete(id).await.unwrap());
        }
        let late = insert(&jobs, NewJob { expires_at: Some(now() - 1), ..order() }).await;
        let lost = insert(&jobs, order()).await;
        assert_eq!(jobs.claim(&claim(SHORT)).await.unwrap().unwrap().job.id, lost);
        tokio::time::sleep(SHORT * 2).await;
        let failed = jobs.fail_hopeless(1, say("expired"), say("abandoned")).await.unwrap();
        assert_eq!(failed, [late, lost]);
        assert_eq!(bytes().await, 2 * 2);
        let failed = jobs.fail_hopeless(1, say("expired"), say("abandoned")).await.unwrap();
        assert!(failed.is_empty());
    });
}

#[test]
fn a_job_expires_in_the_queue_but_not_once_it_has_begun() {
    with_each(async |jobs| {
        jobs.open().await.unwrap();
        let soon = Some(now() + 1000);
        let begun = insert(&jobs, NewJob { expires_at: soon, ..job("me") }).await;
        let lease = take(&jobs).await.unwrap();
        assert_eq!(lease.job.id, begun);
        let late = insert(&jobs, NewJob { expires_at: Some(now() - 1), ..job("me") }).await;
        assert!(take(&jobs).await.is_none());
        tokio::time::sleep(Duration::from_millis(1100)).await;
        jobs.fail_hopeless(3, "expired".to_owned(), "abandoned".to_owned()).await.unwrap();
        assert_eq!(find(&jobs, late).await.error.as_deref(), Some("expired"));
        assert!(jobs.done(&lease, String::new(), 0, &reached(9)).await.unwrap());
    });
}

/// As when a clock is set back, or the clock of who took the order was ahead.
#[test]
fn a_job_that_was_ordered_later_than_now_does_not_wait() {
    with_each(async |jobs| {
        let id = insert(&jobs, job("me")).await;
        let ahead = sqlx::query("UPDATE jobs SET created_at = $1 WHERE id = $2");
        let ahead = ahead.bind(now() + 3_600_000).bind(id.to_string());
        assert!(jobs.change(ahead).await.unwrap());
        assert_eq!(take(&jobs).await.unwrap().job.id, id);
    });
}

#[test]
fn a_retry_waits_and_what_could_not_begin_is_no_start() {
    with_each(async |jobs| {
        let id = insert(&jobs, job("me")).await;
        let lease = take(&jobs).await.unwrap();
        let wait = Duration::from_millis(300);
        assert!(jobs.put_back(&lease, PutBack::Retry(wait)).await.unwrap());
        assert!(take(&jobs).await.is_none());
        tokio::time::sleep(Duration::from_millis(400)).await;
        let lease = take(&jobs).await.unwrap();
        assert_eq!((lease.job.starts, lease.job.faults), (2, 1));
        assert!(jobs.put_back(&lease, PutBack::Release).await.unwrap());
        let released = find(&jobs, id).await;
        assert_eq!((released.state, released.starts), (State::Queued, 1));
        let lease = take(&jobs).await.unwrap();
        assert!(jobs.put_back(&lease, PutBack::Postpone(wait)).await.unwrap());
        assert!(take(&jobs).await.is_none());
        let postponed = find(&jobs, id).await;
        let waits = (postponed.state, postponed.starts, postponed.faults, postponed.started_at);
        assert_eq!(waits, (State::Queued, 1, 2, None));
    });
}

#[test]
fn owners_take_turns_and_each_has_its_jobs_done_by_priority_then_by_age() {
    with_each(async |jobs| {
        for (owner, priority) in
            [("a", 100), ("a", 100), ("b", 0), ("b", -1), ("b", 7), ("a", 5), ("c", -100)]
        {
            insert(&jobs, NewJob { priority, ..job(owner) }).await;
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        let mut order = Vec::new();
        while let Some(lease) = take(&jobs).await {
            order.push((lease.job.owner, lease.job.priority));
        }
        let wanted = [("a", 100), ("b", 7), ("c", -100), ("a", 100), ("b", 0), ("a", 5), ("b", -1)];
        assert_eq!(order, wanted.map(|(owner, priority)| (owner.to_owned(), priority)));
    });
}

#[test]
fn an_owner_with_its_share_and_jobs_of_another_model_are_left_to_others() {
    with_each(async |jobs| {
        let own = insert(&jobs, job("busy")).await;
        let full = ["busy".to_owned(), "other".to_owned()];
        let full = Claim { full: &full, ..claim(LONG) };
        assert!(jobs.claim(&full).await.unwrap().is_none());
        assert_eq!(take(&jobs).await.unwrap().job.id, own);
        let foreign = NewJob { model: "another".to_owned(), ..job("me") };
        let foreign = insert(&jobs, foreign).await;
        let worker = Uuid::new_v4();
        jobs.alive(worker, "another").await.unwrap();
        jobs.alive(worker, "another").await.unwrap();
        assert!(take(&jobs).await.is_none(), "a worker with its model lives");
        jobs.gone(worker).await.unwrap();
        assert_eq!(take(&jobs).await.unwrap().job.id, foreign);
    });
}

#[test]
fn an_idempotency_key_stands_for_one_job_of_its_owner() {
    with_each(async |jobs| {
        let keyed = |owner: &str| NewJob { idempotency_key: Some("k".to_owned()), ..job(owner) };
        let first = insert(&jobs, keyed("me")).await;
        let Inserted::Known(known) = jobs.insert(keyed("me")).await.unwrap() else {
            panic!("the second is the first");
        };
        assert_eq!(known.id, first);
        insert(&jobs, keyed("you")).await;
        insert(&jobs, job("me")).await;
        insert(&jobs, job("me")).await;
        assert_eq!(jobs.kept("me").await.unwrap().jobs, 4);
        jobs.delete(first).await.unwrap();
        insert(&jobs, keyed("me")).await;
    });
}

#[test]
fn a_result_is_found_by_its_content() {
    with_each(async |jobs| {
        let same = || NewJob { content_key: "c".to_owned(), ..job("me") };
        let id = insert(&jobs, same()).await;
        assert!(jobs.find_result("c", 0).await.unwrap().is_none(), "it has none yet");
        let lease = take(&jobs).await.unwrap();
        jobs.done(&lease, "r".to_owned(), 3, &reached(9)).await.unwrap();
        let found = jobs.find_result("c", 0).await.unwrap().unwrap();
        assert_eq!((found.id, found.result_bytes), (id, 3));
        assert!(jobs.find_result("c", now() + 1).await.unwrap().is_none());
        let copy = NewJob { result: Some(("r".to_owned(), 3)), ..same() };
        let copy = insert(&jobs, copy).await;
        let copy = find(&jobs, copy).await;
        assert_eq!((copy.state, copy.result_bytes), (State::Done, 3));
        assert!(take(&jobs).await.is_none());
    });
}

#[test]
fn jobs_are_listed_by_owner_state_and_page() {
    with_each(async |jobs| {
        let mut ids = Vec::new();
        for _ in 0..5 {
            ids.push(insert(&jobs, job("me")).await);
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        insert(&jobs, job("you")).await;
        ids.reverse();
        let all = Listing {
            owner: "me".to_owned(),
            state: None,
            before: None,
            most: 3,
            finished_since: 0,
        };
        let list = async |listing: Listing| {
            let listed = jobs.list(listing).await.unwrap();
            listed.iter().map(|job| job.id).collect::<Vec<_>>()
        };
        assert_eq!(list(all.clone()).await, ids[..3]);
        let last = find(&jobs, ids[2]).await;
        let rest = Listing { before: Some((last.created_at, last.id)), ..all.clone() };
        assert_eq!(list(rest).await, ids[3..]);
        let lease = take(&jobs).await.unwrap();
        jobs.fail(&lease, String::new()).await.unwrap();
        let failed = Listing { state: Some(State::Failed), ..all.clone() };
        assert_eq!(list(failed).await, [lease.job.id]);
        let queued = jobs.count().await.unwrap();
        assert_eq!(queued[0], (State::Queued, 5));
        let later = Listing { finished_since: now() + 1, most: 9, ..all };
        assert_eq!(list(later).await.len(), 4, "what has expired is not shown");
        assert_eq!(jobs.finished_before(now() + 1).await.unwrap(), [lease.job.id]);
    });
}

#[test]
fn what_was_fetched_makes_room_first() {
    with_each(async |jobs| {
        let first = insert(&jobs, job("me")).await;
        jobs.fetched(first).await.unwrap();
        assert_eq!(jobs.oldest_fetched(None).await.unwrap(), None, "it is not done");
        assert_eq!(jobs.oldest_finished(None).await.unwrap(), None);
        let lease = take(&jobs).await.unwrap();
        jobs.fail(&lease, String::new()).await.unwrap();
        jobs.fetched(first).await.unwrap();
        assert_eq!(jobs.oldest_fetched(None).await.unwrap(), Some(first));
        assert_eq!(jobs.oldest_fetched(Some("me")).await.unwrap(), Some(first));
        assert_eq!(jobs.oldest_fetched(Some("you")).await.unwrap(), None);
        assert!(jobs.oldest_finished(Some("me")).await.unwrap().is_some());
    });
}

#[test]
fn the_end_is_reported_until_somebody_takes_the_report() {
    with_each(async |jobs| {
        let url = Some("https://example.org".to_owned());
        let id = insert(&jobs, NewJob { callback_url: url, ..job("me") }).await;
        assert!(jobs.due_callback(LONG, &[]).await.unwrap().is_none(), "it has not ended");
        let lease = take(&jobs).await.unwrap();
        jobs.done(&lease, String::new(), 0, &reached(9)).await.unwrap();
        let full = ["me", "you"].map(str::to_owned);
        assert!(jobs.due_callback(LONG, &full).await.unwrap().is_none(), "others are told first");
        assert_eq!(jobs.due_callback(LONG, &full[1..]).await.unwrap().unwrap().id, id);
        assert!(jobs.due_callback(LONG, &[]).await.unwrap().is_none(), "somebody reports it");
        jobs.reported(id, Some(Duration::ZERO)).await.unwrap();
        assert_eq!(jobs.due_callback(LONG, &[]).await.unwrap().unwrap().callback_tries, 2);
        jobs.reported(id, None).await.unwrap();
        assert!(jobs.due_callback(Duration::ZERO, &[]).await.unwrap().is_none());
    });
}

#[test]
fn many_workers_share_the_jobs_and_none_is_taken_twice() {
    with_each(async |jobs| {
        let mut wanted = HashSet::new();
        for _ in 0..60 {
            wanted.insert(insert(&jobs, job("me")).await);
        }
        let workers = (0..4).map(|_| {
            let jobs = Arc::clone(&jobs);
            tokio::spawn(async move {
                let mut taken = Vec::new();
                while let Some(lease) = take(&jobs).await {
                    taken.push(lease.job.id);
                    assert!(jobs.done(&lease, String::new(), 0, &reached(9)).await.unwrap());
                }
                taken
            })
        });
        let mut all = Vec::new();
        for worker in workers.collect::<Vec<_>>() {
            all.extend(worker.await.unwrap());
        }
        assert_eq!(all.len(), wanted.len());
        assert_eq!(all.into_iter().collect::<HashSet<_>>(), wanted);
    });
}

/// It costs its own job and no other.
#[test]
fn a_row_that_cannot_be_read_is_a_failed_job() {
    with_each(async |jobs| {
        let broken = insert(&jobs, NewJob { priority: 9, ..job("me") }).await;
        let whole = insert(&jobs, job("me")).await;
        let spoil = sqlx::query("UPDATE jobs SET codes_total = -1, faults = -5 WHERE id = $1");
        assert!(jobs.change(spoil.bind(broken.to_string())).await.unwrap());
        let error = jobs.claim(&claim(LONG)).await.unwrap_err();
        assert!(matches!(error, JobsError::Record { .. }), "{error}");
        assert_eq!(take(&jobs).await.unwrap().job.id, whole);
        assert!(take(&jobs).await.is_none());
        let failed = jobs.count().await.unwrap();
        assert!(failed.contains(&(State::Failed, 1)), "{failed:?}");
        let said = jobs.find(broken).await.unwrap_err().to_string();
        assert!(said.contains(&broken.to_string()) && said.contains("faults"), "{said}");
        let listing = Listing {
            owner: "me".to_owned(),
            state: None,
            before: None,
            most: 9,
            finished_since: 0,
        };
        assert_eq!(jobs.list(listing).await.unwrap().len(), 1);
    });
}

#[test]
fn the_end_of_a_job_that_cannot_be_read_is_reported_if_that_can_be() {
    with_each(async |jobs| {
        jobs.open().await.unwrap();
        for (spoil, is_told) in [("order_bytes = -5", true), ("faults = -5", false)] {
            let url = Some("https://example.org".to_owned());
            let id = insert(&jobs, NewJob { callback_url: url, ..job("me") }).await;
            let spoil = sqlx::AssertSqlSafe(format!("UPDATE jobs SET {spoil}"));
            assert!(jobs.change(sqlx::query(spoil)).await.unwrap());
            jobs.claim(&claim(LONG)).await.unwrap_err();
            let due = jobs.due_callback(Duration::ZERO, &[]).await;
            assert_eq!(due.is_ok_and(|due| due.is_some_and(|due| due.id == id)), is_told);
            assert!(is_told || jobs.due_callback(LONG, &[]).await.unwrap().is_none());
            assert!(jobs.delete(id).await.unwrap());
        }
    });
}

#[test]
fn a_database_that_comes_back_is_used_again() {
    let Some(mut postgres) = Postgres::start() else { return };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let jobs = JobTable::at_url(&postgres.url()).unwrap();
        let id = insert(&jobs, job("me")).await;
        postgres.stop();
        let down = jobs.find(id).await.unwrap_err();
        assert!(matches!(down, JobsError::Database(_)), "{down}");
        let never_up = JobTable::at_url(&postgres.url()).unwrap();
        assert!(never_up.open().await.is_err());
        postgres.go_on();
        assert_eq!(find(&jobs, id).await.id, id);
        never_up.open().await.unwrap();
    });
}
