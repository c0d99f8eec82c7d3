//! Jobs that outlive their server.

use std::{
    fs,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    num::NonZeroUsize,
    path::Path,
    sync::{Arc, atomic::Ordering},
    thread,
    time::{Duration, Instant},
};

use bailando::server::{
    CallbackPolicy, JobSettings, JobStorage, Limits, Role, Seconds, Service, StorageConfig,
};
use serde_json::Value;

use crate::server::{
    client::{eventually, small_limits},
    fake::{BLOCK, Fake, PANIC},
    lifecycle::{Server, get, post_to},
};

/// Jobs in a folder.
pub(crate) async fn in_folder(folder: &Path) -> JobStorage {
    let data_dir = Some(folder.to_path_buf());
    StorageConfig { data_dir, ..StorageConfig::default() }.open().await.unwrap()
}

/// A server of a role with these jobs.
pub(crate) async fn server(fake: &Arc<Fake>, storage: JobStorage, role: Role) -> Server {
    // A worker that is gone is missed soon.
    let limits = Limits { job_lease: Seconds(Duration::from_millis(900)), ..small_limits() };
    with_limits(fake, storage, role, limits).await
}

pub(crate) async fn with_limits(
    fake: &Arc<Fake>,
    storage: JobStorage,
    role: Role,
    limits: Limits,
) -> Server {
    let jobs = JobSettings { storage, role, ..JobSettings::default() };
    Server::start_with(fake, Service { limits, jobs, ..Service::default() }).await
}

/// Orders a job; the path that it is asked about at.
pub(crate) async fn order(server: &Server, query: &str, audio: &[u8]) -> String {
    let accepted = server.expect(post_to(&format!("/jobs?{query}"), audio), 202).await;
    header(&accepted, "location")
}

pub(crate) fn header(answer: &str, name: &str) -> String {
    let prefix = format!("{name}: ");
    let found = answer.lines().find_map(|line| line.strip_prefix(&prefix));
    found.unwrap_or_else(|| panic!("no {name} in {answer}")).trim().to_owned()
}

pub(crate) fn json(answer: &str) -> Value {
    let body = answer.split_once("\r\n\r\n").unwrap().1;
    serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {answer}"))
}

/// Asks until the job is in `state`.
pub(crate) async fn until(server: &Server, path: &str, state: &str) -> Value {
    eventually(&format!("{path} is {state}"), async || {
        let status = json(&server.expect(get(path), 200).await);
        assert!(status["state"] != "failed" || state == "failed", "{status}");
        (status["state"] == state).then_some(status)
    })
    .await
}

pub(crate) async fn stop(server: Server) {
    server.stop();
    server.task.await.unwrap().unwrap();
}

fn with_header(mut request: Vec<u8>, header: &str) -> Vec<u8> {
    let end = request.iter().position(|&byte| byte == b'\n').unwrap() + 1;
    request.splice(end..end, format!("{header}\r\n").into_bytes());
    request
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_outlives_its_server_and_so_does_its_result() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let first = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let path = order(&first, "seed=4&format=bvh", b"song").await;
    until(&first, &path, "queued").await;
    stop(first).await;
    assert_eq!(fake.generations.load(Ordering::SeqCst), 0);

    let second = server(&fake, in_folder(folder.path()).await, Role::All).await;
    let done = until(&second, &path, "done").await;
    assert_eq!((&done["starts"], &done["codes_done"]), (&1.into(), &1.into()));
    stop(second).await;

    let third = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let result = format!("{path}/result");
    let whole = third.expect(get(&result), 200).await;
    assert_eq!(header(&whole, "x-seed"), "4");
    let body = whole.split_once("\r\n\r\n").unwrap().1;
    assert!(body.starts_with("HIERARCHY"));
    let part = third.expect(with_header(get(&result), "Range: bytes=4-8"), 206).await;
    assert_eq!(part.split_once("\r\n\r\n").unwrap().1, &body[4..9]);
    assert_eq!(header(&part, "content-range"), format!("bytes 4-8/{}", body.len()));
    assert_eq!(header(&part, "etag"), header(&whole, "etag"));
    third.expect(with_header(get(&result), "Range: bytes=99999999-"), 416).await;
    // Any other format is made of what is stored.
    let glb = third.expect(get(&format!("{result}?format=glb")), 200).await;
    assert!(glb.contains("model/gltf-binary"));
    let part = get(&format!("{result}?format=json"));
    let part = third.expect(with_header(part, "Range: bytes=0-0"), 206).await;
    assert_eq!(part.split_once("\r\n\r\n").unwrap().1, "{");
    assert_eq!(fake.generations.load(Ordering::SeqCst), 1);
    stop(third).await;
}

/// What is not done in time is done by the next process; nothing is lost, so the end is a good one.
#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_stops_gives_its_jobs_back() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let limits = Limits { shutdown_timeout: Seconds(Duration::from_millis(200)), ..small_limits() };
    let storage = in_folder(folder.path()).await;
    let first = with_limits(&fake, storage, Role::All, limits).await;
    let path = order(&first, "", BLOCK).await;
    fake.wait_started(1).await;
    stop(first).await;
    fake.wait_ended(1).await;
    assert!(fake.saw_cancel.load(Ordering::SeqCst));
    let api = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let status = json(&api.expect(get(&path), 200).await);
    assert_eq!((&status["state"], &status["starts"]), (&"queued".into(), &0.into()));
    stop(api).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_request_is_one_job_or_one_dance() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let server = server(&fake, in_folder(folder.path()).await, Role::All).await;
    let keyed = |query: &str, audio: &[u8]| {
        with_header(post_to(&format!("/jobs?{query}"), audio), "Idempotency-Key: one")
    };
    let first = server.expect(keyed("fps=30", b"song"), 202).await;
    let again = server.expect(keyed("fps=30", b"song"), 202).await;
    assert_eq!(header(&first, "location"), header(&again, "location"));
    assert_eq!(header(&again, "idempotency-replayed"), "true");
    for (query, audio) in [("fps=24", &b"song"[..]), ("fps=30", b"sung")] {
        let reused = server.expect(keyed(query, audio), 422).await;
        assert!(reused.contains("idempotency_key_reused"), "{reused}");
    }
    until(&server, &header(&first, "location"), "done").await;
    // Without a key: the same dance where the seed is the same.
    let one = order(&server, "seed=7", b"song").await;
    until(&server, &one, "done").await;
    let made = fake.generations.load(Ordering::SeqCst);
    let other = order(&server, "seed=7", b"song").await;
    let status = json(&server.expect(get(&other), 200).await);
    assert_eq!(status["state"], "done");
    assert_ne!(one, other);
    let results = [one.clone(), other].map(|path| format!("{path}/result"));
    let [first, second] =
        [server.expect(get(&results[0]), 200).await, server.expect(get(&results[1]), 200).await];
    assert_eq!(json(&first), json(&second));
    // Each is deleted alone.
    let delete = format!("DELETE {one} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    server.expect(delete.into_bytes(), 204).await;
    server.expect(get(&results[1]), 200).await;
    assert_eq!(fake.generations.load(Ordering::SeqCst), made);
    order(&server, "", b"song").await;
    eventually("a dance of another seed is made", async || {
        (fake.generations.load(Ordering::SeqCst) > made).then_some(())
    })
    .await;
    stop(server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_are_listed_by_state_and_page() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let server = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let mut paths = Vec::new();
    for _ in 0..3 {
        paths.push(order(&server, "priority=3", b"song").await);
        tokio::time::sleep(Duration::from_millis(3)).await;
    }
    let list = async |query: &str| json(&server.expect(get(&format!("/jobs?{query}")), 200).await);
    let page = list("state=queued&limit=2").await;
    let ids = |page: &Value| -> Vec<String> {
        let jobs = page["jobs"].as_array().unwrap();
        jobs.iter().map(|job| format!("/jobs/{}", job["id"].as_str().unwrap())).collect()
    };
    assert_eq!(ids(&page), [paths[2].clone(), paths[1].clone()]);
    assert_eq!(page["jobs"][0]["priority"], 3);
    let next = page["next"].as_str().unwrap();
    let rest = list(&format!("limit=2&before={next}")).await;
    assert_eq!((ids(&rest), rest.get("next")), (vec![paths[0].clone()], None));
    assert_eq!(list("state=done").await["jobs"], serde_json::json!([]));
    for wrong in ["state=lost", "limit=0", "limit=1001", "before=x", "page=2"] {
        server.expect(get(&format!("/jobs?{wrong}")), 400).await;
    }
    let worker = server_of_worker(&fake, folder.path()).await;
    for request in
        [get("/jobs"), get(&paths[0]), post_to("/jobs", b"song"), post_to("/generate", b"")]
    {
        let refused = worker.expect(request, 404).await;
        assert!(refused.contains("no_jobs_here"), "{refused}");
    }
    let refused = server.expect(post_to("/generate", b"song"), 404).await;
    assert!(refused.contains("no_model_here"), "{refused}");
    stop(worker).await;
    stop(server).await;
}

async fn server_of_worker(fake: &Arc<Fake>, folder: &Path) -> Server {
    server(fake, in_folder(folder).await, Role::Worker).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_of_the_service_is_tried_again_and_one_of_the_song_is_not() {
    for (attempts, starts) in [(2, 9), (9, 2)] {
        let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
        let [job_attempts, job_starts] = [attempts, starts].map(|n| NonZeroUsize::new(n).unwrap());
        let limits = Limits { job_attempts, job_starts, ..small_limits() };
        let storage = in_folder(folder.path()).await;
        let server = with_limits(&fake, storage, Role::All, limits).await;
        let path = order(&server, "", PANIC).await;
        let failed = until(&server, &path, "failed").await;
        assert_eq!(
            (&failed["starts"], &failed["error"]["error_type"]),
            (&2.into(), &"internal".into())
        );
        server.expect(get(&format!("{path}/result")), 500).await;
        let metrics = server.expect(get("/metrics"), 200).await;
        assert!(metrics.contains("bailando_job_retries_total 1"), "{metrics}");
        stop(server).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_waits_too_long_expires() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let api = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let path = order(&api, "expires_s=0.05", b"song").await;
    let failed = until(&api, &path, "failed").await;
    assert_eq!(failed["error"]["error_type"], "job_expired");
    let gone = api.expect(get(&format!("{path}/result")), 410).await;
    assert!(gone.contains("expires_s"), "{gone}");
    let song = folder.path().join(path.trim_start_matches('/')).join("song");
    eventually("its song is deleted", async || (!song.exists()).then_some(())).await;
    stop(api).await;
}

/// However early its client hangs up, an order is a job, or leaves nothing.
#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_is_hung_up_leaves_no_files_behind() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let server = server(&fake, in_folder(folder.path()).await, Role::Api).await;
    let request = post_to("/jobs", "x".repeat(2_000_000).as_bytes());
    for number in 0..40 {
        let (address, request) = (server.address, request.clone());
        let hung_up = tokio::task::spawn_blocking(move || {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.write_all(&request).unwrap();
            thread::sleep(Duration::from_micros(200 * number));
        });
        hung_up.await.unwrap();
    }
    eventually("all that is kept is of jobs", async || {
        let jobs = server.expect(get("/jobs?limit=1000"), 200).await;
        let mut folders = fs::read_dir(folder.path().join("jobs")).into_iter().flatten().flatten();
        let is_known = |folder: fs::DirEntry| jobs.contains(&*folder.file_name().to_string_lossy());
        folders.all(is_known).then_some(())
    })
    .await;
    stop(server).await;
}

/// The store is gone: what needs it is refused, the rest works, and nothing is lost.
#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_fails_is_a_clear_error_and_loses_nothing() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let server = server(&fake, in_folder(folder.path()).await, Role::All).await;
    let path = order(&server, "", b"song").await;
    until(&server, &path, "done").await;
    let jobs = folder.path().join("jobs");
    let aside = folder.path().join("aside");
    fs::rename(&jobs, &aside).unwrap();
    fs::write(&jobs, b"no folder").unwrap();
    let refused = server.expect(post_to("/jobs", b"song"), 503).await;
    assert!(refused.contains("job_store") && refused.contains("retry-after: "), "{refused}");
    server.expect(post_to("/generate", b"song"), 200).await;
    fs::remove_file(&jobs).unwrap();
    fs::rename(&aside, &jobs).unwrap();
    server.expect(get(&format!("{path}/result")), 200).await;
    let path = order(&server, "", b"song").await;
    until(&server, &path, "done").await;
    stop(server).await;
}

/// Accepts calls, answers the first with `status` and the others with 200, and gives each whole.
fn listen(statuses: [u16; 2]) -> (u16, thread::JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let calls = thread::spawn(move || {
        let answer = |status: u16| {
            let (mut stream, _) = listener.accept().unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
            let mut call = Vec::new();
            let mut piece = [0; 4096];
            loop {
                let read = stream.read(&mut piece).unwrap();
                call.extend_from_slice(&piece[..read]);
                if is_whole(&call) || read == 0 {
                    break;
                }
            }
            let said = format!("HTTP/1.1 {status} X\r\nContent-Length: 0\r\n\r\n");
            stream.write_all(said.as_bytes()).unwrap();
            String::from_utf8(call).unwrap()
        };
        statuses.map(answer).to_vec()
    });
    (port, calls)
}

/// Whether a request has as many bytes of body as its head says.
fn is_whole(request: &[u8]) -> bool {
    let text = String::from_utf8_lossy(request).to_ascii_lowercase();
    let Some((head, body)) = text.split_once("\r\n\r\n") else { return false };
    let length = head.lines().find_map(|line| line.strip_prefix("content-length: "));
    length.is_some_and(|length| body.len() >= length.parse().unwrap())
}

/// A server that calls this machine.
async fn caller(fake: &Arc<Fake>, folder: &Path) -> Server {
    let callbacks = CallbackPolicy {
        allow: vec!["127.0.0.1".to_owned()],
        secret: "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".parse().unwrap(),
        private: true,
    };
    let storage = in_folder(folder).await;
    let jobs = JobSettings { storage, callbacks, ..JobSettings::default() };
    let service = Service { limits: small_limits(), jobs, ..Service::default() };
    Server::start_with(fake, service).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_host_that_never_answers_keeps_nobody_else_from_being_told() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = silent.local_addr().unwrap().port();
    let server = caller(&fake, folder.path()).await;
    for _ in 0..3 {
        let url = format!("callback_url=http://127.0.0.1:{port}/");
        let path = order(&server, &url, b"song").await;
        until(&server, &path, "done").await;
    }
    // They are being called.
    let held = tokio::task::spawn_blocking(move || [(); 3].map(|()| silent.accept().unwrap()));
    let held = held.await.unwrap();
    let (port, calls) = listen([204, 204]);
    for _ in 0..2 {
        order(&server, &format!("callback_url=http://127.0.0.1:{port}/"), b"song").await;
    }
    let started = Instant::now();
    tokio::task::spawn_blocking(move || calls.join().unwrap()).await.unwrap();
    assert!(started.elapsed() < Duration::from_secs(5), "they have 10 s each");
    drop(held);
    stop(server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_a_job_is_told_signed_and_told_again_if_it_was_not_taken() {
    let (folder, fake) = (tempfile::tempdir().unwrap(), Fake::new());
    let (port, calls) = listen([500, 204]);
    let server = caller(&fake, folder.path()).await;
    let wrong = "/jobs?callback_url=http://elsewhere.example/";
    let refused = server.expect(post_to(wrong, b"song"), 400).await;
    assert!(refused.contains("does not call elsewhere.example"), "{refused}");
    let path = order(&server, &format!("callback_url=http://127.0.0.1:{port}/told"), b"song").await;
    let started = Instant::now();
    let calls = tokio::task::spawn_blocking(move || calls.join().unwrap()).await.unwrap();
    assert!(started.elapsed() > Duration::from_secs(4), "the second try waits");
    for call in &calls {
        assert!(call.starts_with("POST /told HTTP/1.1"), "{call}");
        let id = path.rsplit_once('/').unwrap().1;
        assert_eq!(header(call, "webhook-id"), format!("msg_{id}"));
        assert!(header(call, "webhook-signature").starts_with("v1,"), "{call}");
        let told = json(call);
        assert_eq!((&told["type"], &told["data"]["state"]), (&"job.done".into(), &"done".into()));
        assert_eq!(told["data"]["result"], format!("{path}/result"));
    }
    stop(server).await;
}
