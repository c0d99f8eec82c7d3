use std::{collections::HashMap, time::Duration};

use uuid::Uuid;

use super::{LONG, claim, find, insert, job, reached, take, with_each};
use crate::{Claim, JobTable, Kept, NewJob, PutBack, State, now};

/// Numbers that look as if they were drawn.
struct Noise(u64);

impl Noise {
    fn below(&mut self, most: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        (self.0 >> 33) % most
    }
}

/// A job as the order of turns sees it.
#[derive(Clone, Debug)]
struct Seen {
    id: String,
    owner: String,
    model: String,
    priority: i64,
    created_at: i64,
    running: bool,
    /// Whether it may begin: it waits, or its worker is gone.
    may: bool,
}

/// A job in some state, older than those that are ordered from now on.
async fn put(jobs: &JobTable, noise: &mut Noise, number: i64) -> Seen {
    let owner = format!("o{}", noise.below(7));
    let model = if noise.below(9) == 0 { "another" } else { "model" };
    let priority = noise.below(3) as i64;
    let kind = noise.below(8);
    let (hour, now) = (3_600_000, now());
    let (state, run_after, lease_until) = match kind {
        0 => ("running", 0, Some(now + hour)),
        1 => ("running", 0, Some(now - hour)),
        2 => ("queued", now + hour, None),
        3 => ("queued", now - hour, None),
        _ => ("queued", 0, None),
    };
    let expires_at = (kind == 4).then_some(now - hour);
    let id = insert(jobs, NewJob { priority, expires_at, model: model.to_owned(), ..job(&owner) });
    let id = id.await.to_string();
    // Some are as old as others.
    let created_at = number / 2;
    let change = sqlx::query(
        "UPDATE jobs SET state = $1, run_after = $2, lease_until = $3, created_at = $4 \
         WHERE id = $5",
    );
    let change = change.bind(state).bind(run_after).bind(lease_until).bind(created_at);
    assert!(jobs.change(change.bind(id.clone())).await.unwrap());
    let may = !matches!(kind, 0 | 2 | 4);
    Seen { id, owner, model: model.to_owned(), priority, created_at, running: kind < 2, may }
}

/// The next one by the rule as it is documented, over all jobs.
fn next(seen: &[Seen], models: &[&str], full: &[String]) -> Option<usize> {
    let mut busy: HashMap<&str, usize> = HashMap::new();
    seen.iter().filter(|job| job.running).for_each(|job| *busy.entry(&job.owner).or_default() += 1);
    let turn = |job: &Seen| {
        let at_work = busy.get(job.owner.as_str()).copied().unwrap_or(0);
        (at_work, -job.priority, job.created_at, job.id.clone())
    };
    let may = |job: &Seen| job.may && models.contains(&&*job.model) && !full.contains(&job.owner);
    (0..seen.len()).filter(|&at| may(&seen[at])).min_by_key(|&at| turn(&seen[at]))
}

#[test]
fn jobs_are_taken_in_the_documented_order_whatever_waits() {
    with_each(async |jobs| {
        for round in 0..6 {
            let mut noise = Noise(round);
            let mut seen = Vec::new();
            for number in 0..60 {
                seen.push(put(&jobs, &mut noise, number).await);
            }
            let full = if round % 3 == 0 { vec!["o1".to_owned(), "o2".to_owned()] } else { vec![] };
            let worker = Uuid::new_v4();
            let models: &[&str] = match round % 2 {
                0 => &["model", "another"],
                _ => {
                    jobs.alive(worker, "another").await.unwrap();
                    &["model"]
                }
            };
            let claim = Claim { full: &full, ..claim(LONG) };
            while let Some(lease) = jobs.claim(&claim).await.unwrap() {
                let wanted = next(&seen, models, &full).unwrap();
                let (taken, wanted) = (lease.job.id.to_string(), &mut seen[wanted]);
                assert_eq!(taken, wanted.id, "{wanted:?}");
                (wanted.running, wanted.may) = (true, false);
                if noise.below(3) == 0 {
                    jobs.done(&lease, String::new(), 0, &reached(9)).await.unwrap();
                    wanted.running = false;
                }
            }
            assert!(next(&seen, models, &full).is_none());
            jobs.change(sqlx::query("DELETE FROM jobs")).await.unwrap();
            jobs.gone(worker).await.unwrap();
        }
    });
}

/// More than are looked at: the first of the whole line are all of an owner with jobs in work.
#[test]
fn whoever_waits_behind_many_jobs_of_another_is_next() {
    with_each(async |jobs| {
        for _ in 0..120 {
            insert(&jobs, NewJob { priority: 9, ..job("much") }).await;
        }
        let few = insert(&jobs, job("few")).await;
        assert_eq!(take(&jobs).await.unwrap().job.owner, "much");
        assert_eq!(take(&jobs).await.unwrap().job.id, few);
        assert_eq!(take(&jobs).await.unwrap().job.owner, "much");
    });
}

#[test]
fn a_name_like_that_of_a_full_owner_is_another() {
    with_each(async |jobs| {
        let (full, other) = (["a_c%".to_owned()], "abcd");
        insert(&jobs, job(&full[0])).await;
        let id = insert(&jobs, job(other)).await;
        let claim = Claim { full: &full, ..claim(LONG) };
        assert_eq!(jobs.claim(&claim).await.unwrap().unwrap().job.id, id);
        assert!(jobs.claim(&claim).await.unwrap().is_none());
    });
}

/// As where jobs are tried again more often than they may be abandoned.
#[test]
fn a_job_that_is_put_back_is_begun_again_however_often_it_has_begun() {
    with_each(async |jobs| {
        let id = insert(&jobs, job("me")).await;
        let once = Claim { most_starts: 1, ..claim(LONG) };
        for starts in 1..4 {
            let lease = jobs.claim(&once).await.unwrap().unwrap();
            assert_eq!((lease.job.id, lease.job.starts), (id, starts));
            jobs.put_back(&lease, PutBack::Retry(Duration::ZERO)).await.unwrap();
        }
    });
}

/// What the database counts is what is there, whatever becomes of jobs.
#[test]
fn what_is_kept_is_counted() {
    with_each(async |jobs| {
        let mut noise = Noise(7);
        let mut known = Vec::new();
        for step in 0..80 {
            match noise.below(5) {
                0 if !known.is_empty() => {
                    let gone = known.swap_remove(noise.below(known.len() as u64) as usize);
                    assert!(jobs.delete(gone).await.unwrap());
                }
                1 => {
                    if let Some(lease) = take(&jobs).await {
                        jobs.done(&lease, "{}".to_owned(), 70, &reached(9)).await.unwrap();
                    }
                }
                2 => {
                    if let Some(lease) = take(&jobs).await {
                        jobs.fail(&lease, "{}".to_owned()).await.unwrap();
                    }
                }
                _ => {
                    let owner = format!("o{}", noise.below(3));
                    let key = (step % 9 == 0).then(|| "once".to_owned());
                    let bytes = noise.below(100) as i64;
                    let new = NewJob { order_bytes: bytes, idempotency_key: key, ..job(&owner) };
                    let id = new.id;
                    jobs.insert(new).await.unwrap();
                    known.extend(jobs.exists(id).await.unwrap().then_some(id));
                }
            }
        }
        let mut all = HashMap::<String, (i64, i64)>::new();
        for id in known {
            let job = find(&jobs, id).await;
            let (jobs, bytes) = all.entry(job.owner).or_default();
            *jobs += 1;
            *bytes += job.order_bytes + job.result_bytes;
        }
        let (total, bytes) = all.values().fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        assert!(total > 5, "{total}");
        for (owner, (own, own_bytes)) in all {
            let kept = jobs.kept(&owner).await.unwrap();
            assert_eq!(kept, Kept { jobs: total, own, bytes, own_bytes }, "{owner}");
        }
        // Whatever one statement changes at once.
        let say = |text: &str| text.to_owned();
        let past = "UPDATE jobs SET expires_at = 1 WHERE state = 'queued'";
        jobs.change(sqlx::query(past)).await.unwrap();
        jobs.fail_hopeless(3, say("expired"), say("abandoned")).await.unwrap();
        assert_eq!(jobs.count().await.unwrap()[0], (State::Queued, 0));
        assert_eq!(jobs.kept("").await.unwrap().bytes, bytes);
        jobs.change(sqlx::query("DELETE FROM jobs")).await.unwrap();
        assert_eq!(jobs.kept("o1").await.unwrap(), Kept::default());
    });
}
