//! The architecture as rules: dependencies point down, files form no circle, lines fit.
//!
//! The rules and their reasons are in `docs/architecture.md`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a rule that cannot be checked is a failed test"
)]

mod graph;
mod source;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use graph::circles;
use source::Crate;

const MAX_COLUMNS: usize = 100;

/// Crates from the bottom to the top. A crate may depend on those of lower levels only.
const LEVELS: [(&str, u8); 13] = [
    ("bailando-core", 0),
    ("bailando-jobs", 0),
    ("bailando-kernels", 0),
    ("bailando-audio", 1),
    ("bailando-features", 2),
    ("bailando-motion", 3),
    ("bailando-formats", 4),
    ("bailando-testkit", 5),
    ("bailando-model", 6),
    ("bailando-codebook", 7),
    ("bailando-eval", 7),
    ("bailando", 8),
    ("bailando-train", 9),
];

/// Libraries that only some files may name: the libraries, where, why.
const CONFINED: [(&[&str], &[&str], &str); 3] = [
    (&["ort"], &["crates/bailando-model/src/"], "only the model crate knows ONNX Runtime"),
    (
        &["axum", "http_body_util", "hyper", "hyper_util", "tower", "tower_http"],
        &["src/server/", "src/cli/healthcheck.rs"],
        "only the server knows HTTP",
    ),
    (
        &["sqlx", "object_store"],
        &["crates/bailando-jobs/src/"],
        "only the jobs crate knows databases and stores",
    ),
];

fn root() -> PathBuf {
    bailando_testkit::project("")
}

/// Folders of all crates, relative to the root.
fn crate_folders() -> Vec<PathBuf> {
    let mut folders = vec![PathBuf::new(), PathBuf::from("train")];
    for entry in fs::read_dir(root().join("crates")).unwrap() {
        folders.push(Path::new("crates").join(entry.unwrap().file_name()));
    }
    folders.sort();
    folders
}

/// Rust files below `folder`, relative to the root.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root().join(&folder)).into_iter().flatten() {
            let entry = entry.unwrap();
            let path = folder.join(entry.file_name());
            if entry.file_type().unwrap().is_dir() {
                let name = entry.file_name();
                if name != "target" && !name.to_string_lossy().starts_with('.') {
                    folders.push(path);
                }
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

fn read(path: &Path) -> String {
    let path = root().join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn files_form_no_circle() {
    let mut found = BTreeSet::new();
    for folder in crate_folders() {
        let source = folder.join("src");
        let files = rust_files(&source).into_iter().map(|file| {
            let path = file.strip_prefix(&source).unwrap().to_path_buf();
            (path, file.display().to_string(), read(&file))
        });
        for circle in circles(&Crate::parse(files).edges()) {
            println!("circle of {} files:", circle.files.len());
            for (from, to, name) in &circle.edges {
                println!("  {from} -> {to} ({name})");
            }
            found.insert(circle.files);
        }
    }
    assert!(found.is_empty(), "files in a circle: {found:#?}");
}

/// Circles in a crate of these files, each as the names of its files.
fn circles_of(files: &[(&str, &str)]) -> Vec<Vec<String>> {
    let files =
        files.iter().map(|(path, text)| (PathBuf::from(path), path.to_string(), text.to_string()));
    let circles = circles(&Crate::parse(files).edges());
    circles.into_iter().map(|circle| circle.files.into_iter().collect()).collect()
}

#[test]
fn a_child_that_uses_its_users_items_closes_a_circle() {
    let parent = "mod a; mod b; pub use a::A; pub use b::B; pub struct Own; fn f() { b::run() }";
    let leaf = ("a.rs", "pub struct A; // crate::b::B");
    let found = circles_of(&[("lib.rs", parent), leaf, ("b.rs", "use super::A; pub fn run() {}")]);
    assert!(found.is_empty(), "declaring and re-exporting is no use: {found:?}");
    let found = circles_of(&[("lib.rs", parent), leaf, ("b.rs", "fn run(_: super::Own) {}")]);
    assert_eq!(found, [["b.rs", "lib.rs"]]);
    let siblings = [
        ("lib.rs", "mod a; mod b; pub use b::B;"),
        ("a.rs", "use crate::{b, B as Other}; pub struct A; const TEXT: &str = \"b::C\";"),
        ("b.rs", "pub struct B; fn f<'a>() -> impl Sized + use<'a> { crate::a::A }"),
    ];
    assert_eq!(circles_of(&siblings), [["a.rs", "b.rs"]]);
    let tested = ("b.rs", "pub struct B; #[cfg(test)] mod tests { use crate::a::A; }");
    let found = circles_of(&[siblings[0], siblings[1], tested]);
    assert!(found.is_empty(), "what tests use does not count: {found:?}");
}

/// Names in the `[dependencies]` and, apart, the `[dev-dependencies]` tables of a `Cargo.toml`.
fn dependencies(manifest: &str) -> (Vec<&str>, Vec<&str>) {
    let (mut normal, mut development, mut table) = (Vec::new(), Vec::new(), "");
    for line in manifest.lines() {
        if line.starts_with('[') {
            table = line.trim_matches(['[', ']']);
        } else if let Some((name, _)) = line.split_once(" = ") {
            if table == "dev-dependencies" {
                development.push(name);
            } else if table == "dependencies" || table.starts_with("target.") {
                normal.push(name);
            }
        }
    }
    (normal, development)
}

#[test]
fn dependencies_point_down() {
    let level = |name: &str| LEVELS.iter().find(|(of, _)| *of == name).map(|(_, level)| *level);
    for folder in crate_folders() {
        let manifest = read(&folder.join("Cargo.toml"));
        let package = manifest.split("[package]\n").nth(1).unwrap();
        let name = package.lines().next().unwrap().trim_start_matches("name = ").trim_matches('"');
        let own = level(name).unwrap_or_else(|| panic!("{name} has no level in this test"));
        let (normal, development) = dependencies(&manifest);
        for used in normal.iter().chain(&development).filter(|name| name.starts_with("bailando")) {
            let is_testkit = *used == "bailando-testkit";
            let below = level(used).is_some_and(|level| level < own);
            assert!(
                if is_testkit { development.contains(used) } else { below },
                "{name} may not depend on {used}"
            );
        }
        for (libraries, files, why) in CONFINED {
            for library in libraries {
                let hyphens = library.replace('_', "-");
                let here = format!("{}/src/", folder.display());
                let here = here.trim_start_matches('/');
                assert!(
                    !normal.contains(&hyphens.as_str())
                        || files.iter().any(|file| file.starts_with(here)),
                    "{name} depends on {library}: {why}"
                );
            }
        }
    }
}

#[test]
fn confined_libraries_are_named_in_their_place_only() {
    for folder in crate_folders() {
        for file in rust_files(&folder.join("src")) {
            let name = file.to_str().unwrap();
            let tokens = source::without_tests(&source::tokens(&read(&file)));
            for (libraries, places, why) in CONFINED {
                if places.iter().any(|place| name.starts_with(place)) {
                    continue;
                }
                for pair in tokens.windows(3) {
                    let starts_path = pair[0] != "::" && pair[0] != "." && pair[2] == "::";
                    assert!(
                        !(starts_path && libraries.contains(&pair[1].as_str())),
                        "{name} names {}: {why}",
                        pair[1]
                    );
                }
            }
        }
    }
}

#[test]
fn lines_fit_the_page() {
    let mut found = Vec::new();
    for file in rust_files(Path::new("")) {
        for (number, line) in read(&file).lines().enumerate() {
            if line.chars().count() > MAX_COLUMNS {
                found.push(format!("{}:{}", file.display(), number + 1));
            }
        }
    }
    assert!(found.is_empty(), "lines above 100 columns: {found:#?}");
}
