//! Several replicas with one database and one store.

use std::{
    collections::HashMap, fs, num::NonZeroUsize, path::Path, sync::atomic::Ordering, time::Duration,
};

use bailando::server::{ByteSize, JobStorage, Limits, Role, Seconds, StorageConfig};
use bailando_testkit::postgres::Postgres;

use crate::server::{
    client::{eventually, small_limits},
    durable::{header, in_folder, json, order, server, stop, until, with_limits},
    fake::{BLOCK, Fake},
    lifecycle::{Server, get, post_to},
};

/// With PostgreSQL where it is installed, else with SQLite.
async fn shared(folder: &Path, postgres: Option<&Postgres>) -> JobStorage {
    let Some(postgres) = postgres else { return in_folder(folder).await };
    let config = StorageConfig {
        data_dir: Some(folder.to_path_buf()),
        database: Some(postgres.url()),
        ..StorageConfig::default()
    };
    config.open().await.unwrap()
}

fn start_postgres() -> Option<Postgres> {
    tokio::task::block_in_place(Postgres::start)
}

fn delete(path: &str) -> Vec<u8> {
    format!("DELETE {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n").into_bytes()
}

#[tokio::test(flavor = "multi_thread")]
async fn two_apis_and_three_workers_share_the_jobs() {
    const JOBS: usize = 40;
    let (folder, postgres) = (tempfile::tempdir().unwrap(), start_postgres());
    let storage = async || shared(folder.path(), postgres.as_ref()).await;
    let fakes = [(); 3].map(|()| Fake::new());
    let apis = [
        server(&fakes[0], storage().await, Role::Api).await,
        server(&fakes[0], storage().await, Role::Api).await,
    ];
    let mut paths = Vec::new();
    for job in 0..JOBS {
        paths.push(order(&apis[job % 2], "", BLOCK).await);
    }
    let mut workers = Vec::new();
    for fake in &fakes {
        workers.push(server(fake, storage().await, Role::Worker).await);
        // All have begun before any goes on.
        fake.wait_started(1).await;
    }
    fakes.iter().for_each(|fake| fake.release());
    for (job, path) in paths.iter().enumerate() {
        // At the other one than it was ordered at.
        let api = &apis[(job + 1) % 2];
        let done = until(api, path, "done").await;
        assert_eq!(done["starts"], 1, "{done}");
        let result = api.expect(get(&format!("{path}/result")), 200).await;
        assert!(result.contains("\"positions\""));
    }
    let made = fakes.each_ref().map(|fake| fake.generations.load(Ordering::SeqCst));
    assert_eq!(made.iter().sum::<usize>(), JOBS, "{made:?}");
    assert!(made.iter().all(|&made| made > 0), "{made:?}");
    let metrics = apis[0].expect(get("/metrics"), 200).await;
    let counted = format!("bailando_jobs{{state=\"done\"}} {JOBS}");
    assert!(metrics.contains(&counted), "{metrics}");
    for server in workers.into_iter().chain(apis) {
        stop(server).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn progress_is_seen_and_a_deletion_felt_across_replicas() {
    let (folder, postgres, fake) = (tempfile::tempdir().unwrap(), start_postgres(), Fake::new());
    let storage = async || shared(folder.path(), postgres.as_ref()).await;
    let api = server(&fake, storage().await, Role::Api).await;
    let worker = server(&fake, storage().await, Role::Worker).await;
    let path = order(&api, "", BLOCK).await;
    fake.wait_started(1).await;
    eventually("the stage is seen", async || {
        let status = json(&api.expect(get(&path), 200).await);
        (status["stage"] == "decode").then_some(())
    })
    .await;
    let started = json(&api.expect(get(&path), 200).await);
    assert!(started["started_at"].as_str() >= started["created_at"].as_str(), "{started}");
    api.expect(delete(&path), 204).await;
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    api.expect(get(&path), 404).await;
    stop(worker).await;
    stop(api).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_matters_more_is_done_first() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let api = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let mut paths = HashMap::new();
    for priority in [0, 9, -9, 5] {
        let audio = format!("song {priority}");
        paths
            .insert(priority, order(&api, &format!("priority={priority}"), audio.as_bytes()).await);
    }
    let worker = server(&fake, in_folder(folder.path()).await, Role::Worker).await;
    for path in paths.values() {
        until(&api, path, "done").await;
    }
    let heard = fake.heard.lock().unwrap().clone();
    assert_eq!(heard, ["song 9", "song 5", "song 0", "song -9"].map(str::as_bytes));
    stop(worker).await;
    stop(api).await;
}

/// A result has its room from the order on: as much as the order says, else as the song seems to
/// take.
#[tokio::test(flavor = "multi_thread")]
async fn no_more_is_ordered_than_there_is_room_for_results() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let limits = Limits { job_bytes: ByteSize(20_000_000), ..Limits::default() };
    let storage = in_folder(folder.path()).await;
    let api = with_limits(&fake, storage, Role::Api, limits).await;
    // Each takes about 7 MB, songs included, and a client has 15 MB.
    let mut paths = Vec::new();
    let long = vec![b's'; 4_000_000];
    for (query, song) in
        [("", &long[..]), ("format=json&fps=60", &long), ("duration_s=1000", b"song")]
    {
        paths.push(order(&api, query, song).await);
    }
    let refused = api.expect(post_to("/jobs", b"song"), 503).await;
    assert!(refused.contains("job_bytes") && refused.contains("waiting jobs"), "{refused}");
    let worker = server(&fake, in_folder(folder.path()).await, Role::Worker).await;
    for path in &paths {
        until(&api, path, "done").await;
    }
    for _ in 0..10 {
        order(&api, "duration_s=4", b"song").await;
    }
    stop(worker).await;
    stop(api).await;
}

/// All of its places are for jobs, and none waits in one for its client's turn.
#[tokio::test(flavor = "multi_thread")]
async fn a_worker_takes_the_jobs_that_it_can_begin_and_leaves_others_the_rest() {
    for (client_share, at_once) in [(1.0, 4), (0.75, 3)] {
        let (folder, fakes) = (tempfile::tempdir().unwrap(), [Fake::new(), Fake::new()]);
        let api = server(&fakes[0], in_folder(folder.path()).await, Role::Api).await;
        let mut paths = Vec::new();
        for _ in 0..=at_once {
            paths.push(order(&api, "", BLOCK).await);
        }
        let mut workers = Vec::new();
        for (fake, begun) in fakes.iter().zip([at_once, 1]) {
            let max_concurrent_requests = NonZeroUsize::new(4).unwrap();
            let limits = Limits { client_share, max_concurrent_requests, ..Limits::default() };
            let storage = in_folder(folder.path()).await;
            workers.push(with_limits(fake, storage, Role::Worker, limits).await);
            fake.wait_started(begun).await;
        }
        fakes.iter().for_each(|fake| fake.release());
        for path in &paths {
            until(&api, path, "done").await;
        }
        for server in workers.into_iter().chain([api]) {
            stop(server).await;
        }
    }
}

/// Stopped and started again under load: 503 with Retry-After meanwhile, then all is well.
#[tokio::test(flavor = "multi_thread")]
async fn a_database_that_goes_and_comes_back_costs_nothing() {
    let Some(mut postgres) = start_postgres() else { return };
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    // Longer than the database is away.
    let limits = Limits { job_lease: Seconds(Duration::from_secs(60)), ..Limits::default() };
    let storage = shared(folder.path(), Some(&postgres)).await;
    let server: Server = with_limits(&fake, storage, Role::All, limits).await;
    let before = order(&server, "", b"song").await;
    until(&server, &before, "done").await;
    let meanwhile = order(&server, "", BLOCK).await;
    fake.wait_started(2).await;
    tokio::task::block_in_place(|| postgres.stop());
    for request in [post_to("/jobs", b"song"), get(&before)] {
        let refused = server.expect(request, 503).await;
        assert!(refused.contains("job_store"), "{refused}");
        assert!(header(&refused, "retry-after").parse::<u64>().unwrap() > 0);
    }
    server.expect(post_to("/generate", b"song"), 200).await;
    server.expect(get("/health"), 200).await;
    // It is done while nobody can be told.
    fake.release();
    tokio::task::block_in_place(|| postgres.go_on());
    let done = until(&server, &meanwhile, "done").await;
    assert_eq!(done["starts"], 1, "it was not made twice: {done}");
    server.expect(get(&format!("{before}/result")), 200).await;
    let after = order(&server, "", b"song").await;
    until(&server, &after, "done").await;
    stop(server).await;
}

/// However often it is tried meanwhile: a store that is away says nothing about a job. A song that
/// is gone for good does.
#[tokio::test(flavor = "multi_thread")]
async fn a_job_waits_for_its_store_and_fails_without_its_song() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let once = NonZeroUsize::MIN;
    let limits = Limits { job_attempts: once, job_starts: once, ..small_limits() };
    let api = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let paths = [order(&api, "", b"song").await, order(&api, "", b"song").await];
    let jobs = folder.path().join("jobs");
    let aside = folder.path().join("aside");
    fs::rename(&jobs, &aside).unwrap();
    fs::write(&jobs, b"no folder").unwrap();
    let storage = in_folder(folder.path()).await;
    let worker = with_limits(&fake, storage, Role::Worker, limits).await;
    eventually("both were tried and wait", async || {
        let metrics = worker.expect(get("/metrics"), 200).await;
        metrics.contains("bailando_job_retries_total 2").then_some(())
    })
    .await;
    let waits = json(&api.expect(get(&paths[0]), 200).await);
    assert_eq!((&waits["state"], &waits["starts"]), (&"queued".into(), &0.into()), "{waits}");
    let song = paths[1].replace("/jobs/", "") + "/song";
    fs::remove_file(aside.join(song)).unwrap();
    fs::remove_file(&jobs).unwrap();
    fs::rename(&aside, &jobs).unwrap();
    let done = until(&api, &paths[0], "done").await;
    assert_eq!(done["starts"], 1, "{done}");
    let failed = until(&api, &paths[1], "failed").await;
    assert_eq!(failed["error"]["error_type"], "job_files_gone");
    let gone = api.expect(get(&format!("{}/result", paths[1])), 410).await;
    assert!(gone.contains("order it again"), "{gone}");
    stop(worker).await;
    stop(api).await;
}
