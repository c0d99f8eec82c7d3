//! Every command of the README and the docs, run as a reader would run it.
//!
//! Blocks of a document run in order, in a folder with the files that commands name, against one
//! server. `CONTRIBUTING.md` says what differs from a reader's machine. A block that cannot run
//! here says why in its fence: `no-run: needs docker`.

use std::{
    env,
    ffi::OsString,
    fs::{self, File},
    io,
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use bailando_testkit::{fixture, project};

/// What commands read. These are copies, since some commands write into the same folders.
const COPIES: [&str; 8] =
    ["Makefile", "benches", "deploy", "docs", "examples", "models", "scripts", "tests/fixtures"];
const PRESETS: &str = "train/presets";
/// The longest that a block may take: far more than it needs on a busy machine.
const PATIENCE: Duration = Duration::from_secs(300);

/// A fenced block of shell commands.
struct Block {
    /// File and line, for messages.
    place: String,
    commands: String,
    /// Why it cannot be run here.
    not_run: Option<String>,
}

fn documents() -> Vec<PathBuf> {
    let mut documents = Vec::new();
    for folder in ["", "docs", "docs/engines", "deploy", "examples"] {
        for entry in fs::read_dir(project(folder)).unwrap() {
            let path = Path::new(folder).join(entry.unwrap().file_name());
            if path.extension().is_some_and(|extension| extension == "md") {
                documents.push(path);
            }
        }
    }
    documents.sort();
    documents
}

/// Returns the blocks of a document in the languages `sh` and `console`, in order.
fn blocks(document: &Path, text: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        let indent = line.len() - line.trim_start().len();
        let Some(fence) = line.trim_start().strip_prefix("```").filter(|_| indent < 4) else {
            continue;
        };
        let place = format!("{}:{}", document.display(), number + 1);
        let (language, rest) = fence.split_once(' ').unwrap_or((fence, ""));
        let inside = lines.by_ref().map(|(_, line)| line);
        let inside = inside.take_while(|line| line.trim_start() != "```");
        let commands: Vec<&str> = match language {
            "sh" => inside.collect(),
            "console" => inside.filter_map(|line| line.trim_start().strip_prefix("$ ")).collect(),
            "bash" | "shell" | "zsh" => panic!("{place}: commands are `sh` or `console`"),
            _ => {
                inside.for_each(drop);
                continue;
            }
        };
        let not_run = rest.strip_prefix("no-run: ").map(str::to_owned);
        assert!(rest.is_empty() || not_run.is_some(), "{place}: what is {rest:?}?");
        blocks.push(Block { place, commands: commands.join("\n"), not_run });
    }
    blocks
}

#[test]
fn blocks_are_read_as_they_are_rendered() {
    let text = "```sh\na\nb\n```\n```json\n{}\n```\n  ```console\n  $ c\n  out\n  ```\n    \
                ```sh\n    x\n```sh no-run: needs a moon\nd\n```";
    let found = blocks(Path::new("x.md"), text);
    let found: Vec<_> = found
        .iter()
        .map(|block| (block.place.as_str(), block.commands.as_str(), block.not_run.as_deref()))
        .collect();
    let expected =
        [("x.md:1", "a\nb", None), ("x.md:8", "c", None), ("x.md:14", "d", Some("needs a moon"))];
    assert_eq!(found, expected);
}

/// A folder in which commands run, and the server that they talk to.
struct Workplace {
    folder: tempfile::TempDir,
    server: Child,
    port: u16,
}

impl Drop for Workplace {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

impl Workplace {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let home = folder.path().join("bailando");
        for name in COPIES.iter().chain([&PRESETS]) {
            copy(&project(name), &home.join(name)).unwrap();
        }
        for (name, of) in [("song.mp3", "demo.mp3"), ("song.flac", "demo.flac")] {
            fs::copy(fixture("audio").join(of), home.join(name)).unwrap();
        }
        fs::write(home.join("hero.glb"), bailando_testkit::rigs::mixamo(1.7).bytes).unwrap();
        fs::create_dir(home.join("album")).unwrap();
        for name in ["album/first.wav", "album/second.wav"] {
            fs::copy(fixture("audio/demo_44k1_8s.wav"), home.join(name)).unwrap();
        }
        if let Some(shared) = bailando_testkit::shared("") {
            let shared = shared.canonicalize().unwrap();
            std::os::unix::fs::symlink(shared, folder.path().join("shared")).unwrap();
        }
        write_stand_ins(&home.join("target/release"));
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut serve = clean(env!("CARGO_BIN_EXE_bailando"), &home);
        let log = File::create(home.join("server.log")).unwrap();
        let server =
            serve.args(["serve", "--port", &port.to_string()]).stderr(log).spawn().unwrap();
        let workplace = Self { folder, server, port };
        workplace.wait_until_ready();
        workplace
    }

    fn home(&self) -> PathBuf {
        self.folder.path().join("bailando")
    }

    fn wait_until_ready(&self) {
        let started = Instant::now();
        let url = format!("http://127.0.0.1:{}/ready", self.port);
        loop {
            let mut probe = clean(env!("CARGO_BIN_EXE_bailando"), &self.home());
            if probe.args(["healthcheck", "--url", &url]).output().unwrap().status.success() {
                return;
            }
            let log = fs::read_to_string(self.home().join("server.log")).unwrap();
            assert!(started.elapsed() < PATIENCE, "the server is not ready: {log}");
            thread::sleep(Duration::from_millis(100));
        }
    }

    /// Runs the commands of a block; an error says how they failed.
    fn run(&self, block: &Block) -> Result<(), String> {
        let commands = block.commands.replace(":8080", &format!(":{}", self.port));
        let log = self.home().join("block.log");
        let output = File::create(&log).unwrap();
        let mut shell = clean("sh", &self.home());
        shell.args(["-eu", "-c", &commands]).stderr(output.try_clone().unwrap()).stdout(output);
        let started = Instant::now();
        let mut child = shell.spawn().unwrap();
        let status = loop {
            match child.try_wait().unwrap() {
                Some(status) => break status.to_string(),
                None if started.elapsed() > PATIENCE => {
                    child.kill().unwrap();
                    break "it does not end".to_owned();
                }
                None => thread::sleep(Duration::from_millis(10)),
            }
        };
        println!("{}: {:.1} s", block.place, started.elapsed().as_secs_f64());
        if status == "exit status: 0" {
            return Ok(());
        }
        let log = fs::read(log).unwrap();
        let said = String::from_utf8_lossy(&log[log.len().saturating_sub(2_000)..]).into_owned();
        Err(format!("{}: {status}\n{commands}\n{said}\n", block.place))
    }
}

/// A command in `folder` without the settings of whoever runs the tests.
fn clean(program: &str, folder: &Path) -> Command {
    let mut command = Command::new(program);
    for (name, _) in env::vars_os() {
        let upper = name.to_string_lossy().to_uppercase();
        if upper.starts_with("BAILANDO_") || upper.ends_with("_PROXY") || upper == "RUST_LOG" {
            command.env_remove(name);
        }
    }
    let outer = env::var_os("PATH").unwrap_or_default();
    let mut path = OsString::from(folder.join("target/release"));
    path.push(":");
    path.push(&outer);
    command.current_dir(folder).stdin(Stdio::null()).env("OUTER_PATH", outer).env("PATH", path);
    command
}

fn copy(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to.parent().unwrap())?;
    if from.is_dir() {
        for entry in fs::read_dir(from)? {
            let name = entry?.file_name();
            copy(&from.join(&name), &to.join(&name))?;
        }
        return Ok(());
    }
    fs::copy(from, to).map(drop)
}

/// Folder of the binaries that were built with this test.
fn binaries() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_bailando")).parent().unwrap()
}

/// Writes what stands before the real programs: `curl` fails where the server refuses, `make` only
/// says what it would do, `bailando serve` ends once it is ready.
fn write_stand_ins(folder: &Path) {
    let real = binaries().display();
    let serve = format!(
        r#"[ "${{1-}}" = serve ] || exec {real}/bailando "$@"
export BAILANDO_PORT=0
{real}/bailando "$@" 2> serve.log & server=$!
until grep -q listening serve.log; do kill -0 $server; sleep 0.1; done
kill -TERM $server; wait $server"#
    );
    let scripts = [
        ("bailando", serve),
        ("bailando-train", format!(r#"exec {real}/bailando-train "$@""#)),
        ("curl", r#"PATH=$OUTER_PATH exec curl --fail-with-body -sS "$@""#.to_owned()),
        ("make", r#"PATH=$OUTER_PATH exec make --dry-run "$@""#.to_owned()),
    ];
    fs::create_dir_all(folder).unwrap();
    for (name, script) in scripts {
        use std::os::unix::fs::PermissionsExt;
        let path = folder.join(name);
        fs::write(&path, format!("#!/bin/sh\nset -eu\n{script}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
}

/// Why a block that could run elsewhere cannot run with what this machine has.
fn missing(block: &Block) -> Option<&'static str> {
    if block.commands.contains("../shared") && bailando_testkit::shared("").is_none() {
        return Some("without the shared test material");
    }
    let trains = block.commands.contains("bailando-train");
    (trains && !binaries().join("bailando-train").exists()).then_some("bailando-train is not built")
}

#[test]
fn commands_of_the_docs_run() {
    let workplace = Workplace::new();
    let (mut run, mut left_out, mut failures) = (0, 0, Vec::new());
    for document in documents() {
        let text = fs::read_to_string(project(&document)).unwrap();
        for block in blocks(&document, &text) {
            let reason = block.not_run.clone().or_else(|| missing(&block).map(str::to_owned));
            if let Some(reason) = reason {
                println!("{}: not run, {reason}", block.place);
                left_out += 1;
            } else {
                run += 1;
                failures.extend(workplace.run(&block).err());
            }
        }
    }
    println!("{run} blocks of commands run, {left_out} not");
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// The book is built, and every link and heading in it exists.
#[test]
fn the_book_is_whole() {
    if !Command::new("mdbook").arg("--version").output().is_ok_and(|said| said.status.success()) {
        println!("skipped: mdbook is not installed (scripts/build-book.sh says how)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let build = Command::new(project("scripts/build-book.sh")).arg(folder.path()).output().unwrap();
    assert!(build.status.success(), "{build:?}");
}

/// Every page of `docs` is in the book's table of contents.
#[test]
fn the_book_has_every_page() {
    let contents = fs::read_to_string(project("docs/SUMMARY.md")).unwrap();
    for document in documents() {
        let Ok(page) = document.strip_prefix("docs") else { continue };
        let link = format!("]({})", page.display());
        let is_page = page != Path::new("SUMMARY.md");
        assert!(!is_page || contents.contains(&link), "docs/SUMMARY.md lacks {}", page.display());
    }
}

/// Links between the documents lead to files that exist.
#[test]
fn links_lead_somewhere() {
    for document in documents() {
        let text = fs::read_to_string(project(&document)).unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let (file, _) = link.split_once('#').unwrap_or((link, ""));
            let is_local = !file.is_empty() && !file.contains("://") && !file.contains(' ');
            let target = project(document.parent().unwrap()).join(file);
            assert!(!is_local || target.exists(), "{}: {link}", document.display());
        }
    }
}
