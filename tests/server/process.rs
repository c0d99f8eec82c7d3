//! The program itself: start, stop, health check.

use std::{
    fs,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    path::Path,
    process::{Child, Command, ExitStatus, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use bailando_testkit::{model::tiny_dancer, read_json, sound::clicks, wav::wav16};

use crate::server::client::LONG;

/// Runs the program with a tiny model, without the settings of the environment.
fn bailando(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bailando"));
    command.current_dir(env!("CARGO_MANIFEST_DIR")).args(arguments);
    for (name, _) in std::env::vars_os() {
        let upper = name.to_string_lossy().to_uppercase();
        if upper.starts_with("BAILANDO_") || upper.ends_with("_PROXY") || upper == "RUST_LOG" {
            command.env_remove(name);
        }
    }
    command.env("BAILANDO_MODEL_DIR", tiny_dancer());
    // Tests that run at the same time have no jobs in common.
    command.env("BAILANDO_DATA_DIR", "none");
    command
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A running server; killed if the test fails.
struct Running(Child);

impl Running {
    fn terminate(&self) {
        let pid = self.0.id().to_string();
        let sent = Command::new("kill").args(["-TERM", &pid]).status();
        assert!(sent.unwrap().success());
    }

    fn wait(&mut self) -> ExitStatus {
        let started = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status;
            }
            assert!(started.elapsed() < LONG, "it does not end");
            thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

fn get(port: u16, path: &str) -> Option<String> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    let request = format!("GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    Some(answer)
}

fn get_patiently(port: u16, path: &str) -> String {
    let started = Instant::now();
    loop {
        if let Some(answer) = get(port, path) {
            return answer;
        }
        assert!(started.elapsed() < LONG, "nothing answers");
        thread::sleep(Duration::from_millis(10));
    }
}

fn wait_until_ready(port: u16) {
    let started = Instant::now();
    while !get_patiently(port, "/ready").starts_with("HTTP/1.1 200") {
        assert!(started.elapsed() < LONG, "it is never ready");
        thread::sleep(Duration::from_millis(10));
    }
}

/// Writes a model with an empty file of a terabyte: reading it takes longer than any test.
fn endless_model(folder: &Path) {
    const BYTES: u64 = 1 << 40;
    let mut manifest = read_json(&tiny_dancer().join("manifest.json"));
    for (name, file) in manifest["files"].as_object_mut().unwrap() {
        file["bytes"] = BYTES.into();
        let empty = fs::File::create(folder.join(name)).unwrap();
        empty.set_len(BYTES).unwrap();
    }
    fs::write(folder.join("manifest.json"), manifest.to_string()).unwrap();
}

#[test]
fn sigterm_while_the_model_is_loaded_ends_the_process_well() {
    let folder = tempfile::tempdir().unwrap();
    endless_model(folder.path());
    let port = free_port();
    let child = bailando(&["serve", "--port", &port.to_string(), "--model-dir"])
        .arg(folder.path())
        .stderr(Stdio::null())
        .spawn();
    let mut server = Running(child.unwrap());
    let health = get_patiently(port, "/health");
    assert!(health.starts_with("HTTP/1.1 200"), "{health}");
    let ready = get(port, "/ready").unwrap();
    assert!(ready.starts_with("HTTP/1.1 503"), "{ready}");
    assert!(ready.contains("\"loading\""), "{ready}");
    let mut half = TcpStream::connect(("127.0.0.1", port)).unwrap();
    half.write_all(b"GET /health HTTP/1.1\r\nHost: x\r\n").unwrap();
    server.terminate();
    assert_eq!(server.wait().code(), Some(0));
}

#[test]
fn a_wrong_model_directory_ends_with_one_line_and_soon() {
    let started = Instant::now();
    let output = bailando(&["serve", "--port", "0", "--model-dir", "src"]).output().unwrap();
    assert!(started.elapsed() < Duration::from_secs(2));
    let said = said(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("src/manifest.json"), "{said}");
    assert_eq!(said.trim_end().lines().count(), 1, "{said}");
}

#[test]
fn an_address_that_is_taken_is_named_with_the_reason() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let output = bailando(&["serve", "--port", &port.to_string()]).output().unwrap();
    let said = said(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains(&format!("cannot listen on 127.0.0.1:{port}: ")), "{said}");
    assert_eq!(said.trim_end().lines().count(), 1, "{said}");
}

#[test]
fn limits_that_mean_nothing_are_wrong_use() {
    for (arguments, wanted) in [
        (&["--max-audio-seconds=nan"][..], "above 0"),
        (&["--max-audio-seconds=-5"], "above 0"),
        (
            &["--min-audio-seconds=9", "--max-audio-seconds=8"],
            "--min-audio-seconds 9 must not be above",
        ),
        (
            &["--min-sample-rate=9000", "--max-sample-rate=8000"],
            "--min-sample-rate 9000 must not be above",
        ),
        (
            &["--upload-memory=100MB"],
            "--upload-memory 100MB is less than the largest song and rig in a form",
        ),
        (
            &["--audio-seconds-in-flight=599"],
            "--audio-seconds-in-flight 599 is less than --max-audio-seconds 600",
        ),
        (&["--request-timeout=1e19"], "no more than ten years"),
        (
            &["--cors-allow-origin=https://a.example,https://b.example/page"],
            "'https://b.example/page'",
        ),
    ] {
        let output = bailando(&["serve", "--port", "0", "--model-dir", "src"])
            .args(arguments)
            .output()
            .unwrap();
        let said = said(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(wanted), "{said}");
    }
}

/// Accepts one request, answers it with 200, and returns its first line in lower case and its body.
fn answer_once(listener: TcpListener) -> thread::JoinHandle<(String, Vec<u8>)> {
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            head.extend(byte);
        }
        let head = String::from_utf8(head).unwrap().to_lowercase();
        let mut lines = head.lines();
        let length = lines.clone().find_map(|line| line.strip_prefix("content-length: "));
        let mut body = vec![0; length.map_or(0, |length| length.parse().unwrap())];
        stream.read_exact(&mut body).unwrap();
        stream
            .write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            .unwrap();
        (lines.next().unwrap().to_owned(), body)
    })
}

#[test]
fn the_probe_asks_where_the_settings_say_and_no_proxy() {
    type Settings = fn(&mut Command, u16);
    let cases: [(Settings, &str); 3] = [
        (
            |probe, port| {
                probe.env("BAILANDO_HOST", "0.0.0.0").env("BAILANDO_PORT", port.to_string());
            },
            "/health",
        ),
        (
            |probe, port| {
                probe
                    .env("BAILANDO_PORT", "1")
                    .env("BAILANDO_HEALTH_URL", format!("http://127.0.0.1:{port}/a"));
            },
            "/a",
        ),
        (
            |probe, port| {
                probe
                    .env("BAILANDO_HEALTH_URL", "http://127.0.0.1:1/a")
                    .args(["--url", &format!("http://127.0.0.1:{port}/b")]);
            },
            "/b",
        ),
    ];
    for (settings, path) in cases {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let mut probe = bailando(&["healthcheck", "--timeout", "10"]);
        for name in ["HTTP_PROXY", "http_proxy", "ALL_PROXY"] {
            probe.env(name, "http://127.0.0.1:1");
        }
        settings(&mut probe, port);
        let asked = thread::spawn(move || probe.output().unwrap());
        let asked_for = answer_once(listener);
        let output = asked.join().unwrap();
        assert!(output.status.success(), "{path}: {}", said(&output));
        let line = asked_for.join().unwrap().0;
        assert_eq!(line, format!("get {path} http/1.1"));
    }
}

/// The last spans are sent when the server stops.
#[test]
fn traces_go_to_the_collector_that_the_settings_name() {
    let collector = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}", collector.local_addr().unwrap());
    let port = free_port();
    let child = bailando(&["serve", "--port", &port.to_string()])
        .args(["--otlp-endpoint", &endpoint])
        .stderr(Stdio::null())
        .spawn();
    let mut server = Running(child.unwrap());
    let collected = answer_once(collector);
    wait_until_ready(port);
    server.terminate();
    assert_eq!(server.wait().code(), Some(0));
    let (line, body) = collected.join().unwrap();
    assert_eq!(line, "post /v1/traces http/1.1");
    let body = String::from_utf8_lossy(&body);
    assert!(body.contains("bailando") && body.contains("request"), "{body}");
    assert!(body.contains("/ready"), "{body}");
}

fn exchange(port: u16, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.write_all(request).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

/// `kill -9` while songs are danced to: the next process on the same folder does all of them.
#[test]
fn killed_jobs_are_done_by_the_next_process() {
    let folder = tempfile::tempdir().unwrap();
    let start = || {
        let port = free_port();
        let mut server = bailando(&["serve", "--port", &port.to_string(), "--job-lease", "1"]);
        server.arg("--data-dir").arg(folder.path().join("data")).stderr(Stdio::null());
        let server = Running(server.spawn().unwrap());
        wait_until_ready(port);
        (server, port)
    };
    let song = wav16(1, 22_050, &clicks(20.0, 22_050, 0.1, Some(0.5)));
    let mut order = format!(
        "POST /jobs HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
        song.len()
    )
    .into_bytes();
    order.extend(song);
    let (mut server, mut port) = start();
    let mut jobs = Vec::new();
    for wait in [0, 150, 400] {
        for _ in 0..2 {
            let accepted = exchange(port, &order);
            assert!(accepted.starts_with("HTTP/1.1 202"), "{accepted}");
            let path = accepted.lines().find_map(|line| line.strip_prefix("location: "));
            jobs.push(path.unwrap().to_owned());
        }
        thread::sleep(Duration::from_millis(wait));
        server.0.kill().unwrap();
        (server, port) = start();
    }
    let started = Instant::now();
    for job in &jobs {
        while !get_patiently(port, job).contains("\"state\":\"done\"") {
            assert!(started.elapsed() < LONG * 4, "{}", get_patiently(port, job));
            thread::sleep(Duration::from_millis(50));
        }
        let result = get_patiently(port, &format!("{job}/result"));
        assert!(result.ends_with('}'), "a result is torn");
    }
    server.terminate();
    assert_eq!(server.wait().code(), Some(0));
}

#[test]
fn a_folder_that_cannot_be_written_to_is_named_or_done_without() {
    let refused = bailando(&["serve", "--port", "0", "--data-dir", "/proc/nothing"]).output();
    let refused = refused.unwrap();
    assert_eq!(refused.status.code(), Some(1));
    let said = said(&refused);
    assert!(said.contains("/proc/nothing"), "{said}");
    assert_eq!(said.trim_end().lines().count(), 1, "{said}");
    let apart = bailando(&["serve", "--port", "0", "--role", "api"]).output().unwrap();
    assert_eq!(apart.status.code(), Some(2));
    // The default folder is another matter: jobs are kept in memory.
    let port = free_port();
    let mut server = bailando(&["serve", "--port", &port.to_string()]);
    server.env_remove("BAILANDO_DATA_DIR").current_dir("/proc").stderr(Stdio::null());
    let mut server = Running(server.spawn().unwrap());
    wait_until_ready(port);
    server.terminate();
    assert_eq!(server.wait().code(), Some(0));
}

#[test]
fn a_key_is_asked_for_and_never_logged() {
    const KEY: &str = "a-key-that-nobody-guesses";
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("keys");
    fs::write(&file, format!("{KEY}\n")).unwrap();
    let port = free_port();
    let log = folder.path().join("log");
    let child = bailando(&["serve", "--port", &port.to_string(), "--json-output"])
        .arg("--api-key-file")
        .arg(&file)
        .env("BAILANDO_API_KEY", "another-key")
        .env("RUST_LOG", "trace")
        .stderr(fs::File::create(&log).unwrap())
        .spawn();
    let mut server = Running(child.unwrap());
    wait_until_ready(port);
    let ask = |key: &str| {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let head = format!("GET /codes HTTP/1.1\r\nHost: x\r\nConnection: close\r\n{key}\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    assert!(ask("").starts_with("HTTP/1.1 401"));
    assert!(ask("X-API-Key: wrong\r\n").starts_with("HTTP/1.1 401"));
    for key in [KEY, "another-key"] {
        let answer = ask(&format!("Authorization: Bearer {key}\r\n"));
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    }
    server.terminate();
    assert_eq!(server.wait().code(), Some(0));
    let log = fs::read_to_string(&log).unwrap();
    assert!(log.contains("answered"), "{log}");
    assert!(!log.contains(KEY) && !log.contains("another-key"));
    let missing =
        bailando(&["serve", "--port", "0", "--api-key-file", "no/such/file"]).output().unwrap();
    let said = said(&missing);
    assert_eq!(missing.status.code(), Some(1), "{said}");
    assert!(said.contains("no/such/file"), "{said}");
}
