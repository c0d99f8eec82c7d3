//! The viewer at `/`, and whether its committed build is that of its sources.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use axum::{
    body::Body,
    http::{Method, Request, StatusCode},
};
use bailando::server::{Access, Limits};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::server::{
    client::{Answer, app, app_for, get, send, with},
    fake::Fake,
};

async fn viewer(path: &str) -> Answer {
    get(&app(&Fake::new(), &Limits::default()), path).await
}

#[tokio::test]
async fn the_page_runs_nothing_but_its_own_files() {
    let page = viewer("/").await;
    assert_eq!(page.status, StatusCode::OK);
    assert_eq!(page.header("content-type"), "text/html; charset=utf-8");
    assert_eq!(page.header("x-content-type-options"), "nosniff");
    let policy = page.header("content-security-policy").to_owned();
    assert!(policy.starts_with("default-src 'none'; script-src 'self'; style-src 'self';"));
    for hole in ["unsafe", "http", "*"] {
        assert!(!policy.contains(hole), "{policy}");
    }
    let html = String::from_utf8(page.body).unwrap();
    for hole in ["<style", "style=", "onclick=", "://"] {
        assert!(!html.contains(hole), "{hole}");
    }
    assert!(html.matches("<script").count() == html.matches(" src=\"./viewer/").count());
}

#[tokio::test]
async fn every_built_file_is_served_with_its_type_and_tag() {
    let app = app(&Fake::new(), &Limits::default());
    for file in built().keys() {
        let path = if file == "index.html" { "/".to_owned() } else { format!("/{file}") };
        let answer = get(&app, &path).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}");
        let bytes = fs::read(web().join("dist").join(file)).unwrap();
        assert!(answer.body == bytes, "{path}");
        let head = Request::builder().method(Method::HEAD).uri(&path).body(Body::empty()).unwrap();
        assert_eq!(send(&app, head).await.status, StatusCode::OK, "{path}");
        let tag = format!("\"other\", {}", answer.header("etag"));
        let again = Request::builder().uri(&path).body(Body::empty()).unwrap();
        let again = send(&app, with(again, "if-none-match", &tag)).await;
        assert_eq!((again.status, again.body.len()), (StatusCode::NOT_MODIFIED, 0), "{path}");
    }
    for path in ["/viewer/other.js", "/viewer/../index.html", "/viewer/index.html", "/index.html"] {
        get(&app, path).await.expect_error(404, "not_found");
    }
}

#[tokio::test]
async fn without_the_viewer_the_root_leads_to_the_documentation() {
    let access = Access { no_viewer: true, ..Access::default() };
    let app = app_for(&Fake::new(), &Limits::default(), access);
    let root = get(&app, "/").await;
    assert_eq!((root.status, root.header("location")), (StatusCode::SEE_OTHER, "/docs/"));
    get(&app, "/viewer/index.js").await.expect_error(404, "not_found");
}

/// `make web` builds it again.
#[test]
fn the_committed_build_is_that_of_the_sources() {
    let stamp = stamp();
    let mut sources: Vec<PathBuf> =
        ["index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"]
            .map(|file| web().join(file))
            .into();
    sources.extend(["src", "public"].iter().flat_map(|folder| files(&web().join(folder))));
    let mut lines: Vec<_> = sources.iter().map(|file| (name(&web(), file), hash(file))).collect();
    lines.sort();
    let list: String = lines.iter().map(|(file, hash)| format!("{hash}  {file}\n")).collect();
    assert_eq!(stamp["sources"], hex(list.as_bytes()), "web/dist is out of date: run `make web`");
    let mut found: BTreeMap<_, _> = files(&web().join("dist"))
        .iter()
        .map(|file| (name(&web().join("dist"), file), hash(file)))
        .collect();
    found.remove("build.json");
    assert_eq!(found, built(), "web/dist was edited by hand: run `make web`");
}

fn web() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("web")
}

fn stamp() -> Value {
    serde_json::from_slice(&fs::read(web().join("dist/build.json")).unwrap()).unwrap()
}

/// The built files and their hashes, as the build names them.
fn built() -> BTreeMap<String, String> {
    serde_json::from_value(stamp()["files"].clone()).unwrap()
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

fn name(root: &Path, file: &Path) -> String {
    let name = file.strip_prefix(root).unwrap();
    name.iter().map(|part| part.to_str().unwrap()).collect::<Vec<_>>().join("/")
}

fn hash(file: &Path) -> String {
    hex(&fs::read(file).unwrap())
}

fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}
