//! Model directories from strangers: nothing outside of the folder is read, nothing is allocated
//! because a file says so, and nothing takes forever.

mod onnx;

use std::{
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

use bailando_model::{ModelDirectory, ModelError, file_sha256};
use bailando_testkit::{model::tiny_dancer, read_json};
use serde_json::{Value, json};
use tempfile::TempDir;

const GRAPHS: [&str; 3] = ["gpt.onnx", "decoder.onnx", "encoder.onnx"];

/// A model directory of files that are no graphs, and a file beside it that nobody may read.
struct Stranger {
    outer: TempDir,
    manifest: Value,
}

impl Stranger {
    fn new() -> Self {
        let mut manifest = read_json(&tiny_dancer().join("manifest.json"));
        manifest["files"] = json!({});
        let mut new = Self { outer: tempfile::tempdir().unwrap(), manifest };
        fs::create_dir(new.folder()).unwrap();
        fs::write(new.outside(), SECRET).unwrap();
        for name in GRAPHS {
            new.put(name, SECRET);
        }
        new
    }

    fn folder(&self) -> PathBuf {
        self.outer.path().join("model")
    }

    fn outside(&self) -> PathBuf {
        self.outer.path().join("outside")
    }

    /// Lists a file, whether it is there or not.
    fn list(&mut self, name: &str, content: &[u8]) {
        let sha256 = file_sha256(&mut &*content).unwrap();
        self.manifest["files"][name] = json!({ "bytes": content.len(), "sha256": sha256 });
    }

    fn put(&mut self, name: &str, content: &[u8]) {
        fs::write(self.folder().join(name), content).unwrap();
        self.list(name, content);
    }

    fn open(&self) -> Result<ModelDirectory, ModelError> {
        let text = serde_json::to_vec(&self.manifest).unwrap();
        fs::write(self.folder().join("manifest.json"), text).unwrap();
        ModelDirectory::open(&self.folder())
    }

    #[track_caller]
    fn refusal(&self) -> ModelError {
        self.open().unwrap_err()
    }

    /// What becomes of an encoder with this graph.
    fn encoder(&mut self, graph: &[u8]) -> Result<(), ModelError> {
        self.put("encoder.onnx", graph);
        self.open().unwrap().encoder(1).map(drop)
    }
}

const SECRET: &[u8] = &[0, 0, 0x80, 0x3f];

#[test]
fn names_that_lead_elsewhere_are_refused() {
    assert!(Stranger::new().open().is_ok());
    let absolute = Stranger::new().outside();
    let absolute = absolute.to_str().unwrap();
    for name in ["../outside", absolute, "a/../../outside", "..", "a\\b", "c:x", ".x", ""] {
        let mut stranger = Stranger::new();
        stranger.list(name, SECRET);
        let error = stranger.refusal();
        assert!(matches!(error, ModelError::Manifest { .. }), "{error}");
        assert!(error.to_string().contains("not a plain file name"), "{error}");
    }
}

#[test]
fn links_out_of_the_folder_are_refused() {
    for name in ["gpt.onnx", "more.bin"] {
        let mut stranger = Stranger::new();
        let link = stranger.folder().join(name);
        let _ = fs::remove_file(&link);
        symlink(stranger.outside(), &link).unwrap();
        // Even one that says what the file is.
        stranger.list(name, SECRET);
        let error = stranger.refusal();
        assert!(matches!(error, ModelError::Outside { .. }), "{error}");
        assert!(error.to_string().contains(name), "{error}");
    }
    let stranger = Stranger::new();
    stranger.open().unwrap();
    let manifest = stranger.folder().join("manifest.json");
    fs::rename(&manifest, stranger.outside()).unwrap();
    symlink(stranger.outside(), &manifest).unwrap();
    let error = ModelDirectory::open(&stranger.folder()).unwrap_err();
    assert!(matches!(error, ModelError::Outside { .. }), "{error}");
}

/// Volumes of Kubernetes look like this; a folder may be a link as a whole, too.
#[test]
fn links_inside_the_folder_are_followed() {
    let stranger = Stranger::new();
    let folder = stranger.folder();
    fs::create_dir(folder.join("..data")).unwrap();
    for name in GRAPHS {
        fs::rename(folder.join(name), folder.join("..data").join(name)).unwrap();
        symlink(Path::new("..data").join(name), folder.join(name)).unwrap();
    }
    stranger.open().unwrap();
    let link = stranger.outer.path().join("link");
    symlink(&folder, &link).unwrap();
    ModelDirectory::open(&link).unwrap();
}

#[test]
fn what_is_no_file_is_not_read() {
    let mut stranger = Stranger::new();
    let pipe = stranger.folder().join("pipe");
    let made = Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    stranger.list("pipe", b"");
    let error = stranger.refusal();
    assert!(error.to_string().contains("no regular file"), "{error}");
    fs::remove_file(&pipe).unwrap();
    fs::create_dir(&pipe).unwrap();
    let error = stranger.refusal();
    assert!(error.to_string().contains("no regular file"), "{error}");
}

#[test]
fn declared_sizes_are_bounded() {
    let mut stranger = Stranger::new();
    stranger.manifest["files"]["gpt.onnx"]["bytes"] = json!(u64::MAX);
    let error = stranger.refusal();
    assert!(matches!(error, ModelError::Mismatch { .. }), "{error}");

    let huge = json!(1_u64 << 60);
    for (pointer, value) in [
        ("/gpt/block", &huge),
        ("/gpt/channels", &huge),
        ("/gpt/layers", &huge),
        ("/decoder/width", &huge),
        ("/decoder/receptive_codes", &huge),
        ("/vocabulary/upper", &huge),
        ("/vocabulary/lower", &huge),
        ("/features/columns", &huge),
        ("/frames_per_code", &huge),
        ("/sampling/candidates", &huge),
        ("/sampling/hop", &huge),
        ("/features/count_periods", &json!(vec![1; 1_000])),
        ("/features/counts_late_s", &json!(0.5)),
        ("/start_codes", &json!([[u32::MAX, 0]])),
        // Each is allowed, all of them together are terabytes.
        (
            "/gpt",
            &json!({"block": 4096, "context": 4095, "channels": 16_384, "layers": 256, "heads": 1}),
        ),
    ] {
        let mut stranger = Stranger::new();
        // Not every field is written where its value is the usual one.
        let (section, field) = pointer.rsplit_once('/').unwrap();
        stranger.manifest.pointer_mut(section).unwrap()[field] = value.clone();
        let error = stranger.refusal();
        assert!(matches!(error, ModelError::Manifest { .. }), "{pointer}: {error}");
    }
}

/// A BVH file is written joint by joint, each inside the one above.
#[test]
fn a_skeleton_is_no_chain_without_end() {
    let joints: Vec<usize> = (0..100_000).collect();
    let mut stranger = Stranger::new();
    stranger.manifest["skeleton"] = json!({
        "joints": joints.iter().map(usize::to_string).collect::<Vec<_>>(),
        "parents": joints.iter().map(|&joint| joint as i64 - 1).collect::<Vec<_>>(),
        "offsets": vec![[0.0, 0.1, 0.0]; joints.len()],
        "root_height": 1.0,
    });
    stranger.manifest["upper_joints"] = json!(joints);
    stranger.manifest["lower_joints"] = json!([]);
    let error = stranger.refusal().to_string();
    assert!(error.contains("number of joints is 100000"), "{error}");
}

#[test]
fn a_manifest_without_end_is_not_read_to_its_end() {
    let stranger = Stranger::new();
    stranger.open().unwrap();
    let manifest = stranger.folder().join("manifest.json");
    let file = fs::OpenOptions::new().write(true).open(manifest).unwrap();
    file.set_len(1 << 40).unwrap();
    let error = ModelDirectory::open(&stranger.folder()).unwrap_err();
    assert!(matches!(error, ModelError::Manifest { .. }), "{error}");
}

#[test]
fn graphs_hold_all_their_values() {
    let mut stranger = Stranger::new();
    let plain = onnx::adding(&onnx::tensor(&[1], &[1.0]));
    stranger.encoder(&plain).unwrap();
    stranger.put("listed.bin", SECRET);
    symlink(stranger.outside(), stranger.folder().join("link.bin")).unwrap();
    let absolute = stranger.outside();
    for location in [
        "../outside",
        "../../../../../../etc/passwd",
        absolute.to_str().unwrap(),
        "link.bin",
        "listed.bin",
        "gpt.onnx",
        // ONNX Runtime's own sign for values in memory, with their address as the offset.
        "*/_ORT_MEM_ADDR_/*",
    ] {
        let place = [("location", location), ("offset", "0"), ("length", "4")];
        let tensor = onnx::external_tensor(&[1], &place);
        let nodes = onnx::constant("weight", &tensor);
        for graph in [
            onnx::adding(&tensor),
            onnx::model(&[onnx::bytes(1, &nodes), onnx::bytes(1, &onnx::add())]),
        ] {
            let error = stranger.encoder(&graph).unwrap_err();
            assert!(matches!(error, ModelError::GraphFile { .. }), "{error}");
            assert!(error.to_string().contains("in another file"), "{error}");
        }
    }
}

/// Loops never end, and constants that unfold fill the memory while the runtime reads the graph.
#[test]
fn graphs_run_the_operators_that_ours_have_and_no_others() {
    let graph_attribute = onnx::bytes(5, &onnx::bytes(6, &onnx::bytes(2, b"body")));
    let other_domain = onnx::bytes(7, b"com.example");
    let long = "A".repeat(1_000);
    for (operator, rest, problem) in [
        ("Loop", &[][..], "\"Loop\""),
        ("ConstantOfShape", &[], "\"ConstantOfShape\""),
        ("Expand", &[], "\"Expand\""),
        ("Range\n", &[], "\"Range\\n\""),
        ("", &[], "\"\""),
        (&long, &[], "too long"),
        ("Add", &graph_attribute, "inside of the graph"),
        ("Add", &other_domain, "another domain"),
    ] {
        let node = onnx::node(operator, &["motion", "weight"], "codes", rest);
        let tensor = onnx::tensor(&[1], &[1.0]);
        let graph = onnx::model(&[onnx::bytes(1, &node), onnx::bytes(5, &tensor)]);
        let error = Stranger::new().encoder(&graph).unwrap_err();
        assert!(matches!(error, ModelError::GraphFile { .. }), "{error}");
        assert!(error.to_string().contains(problem), "{error}");
    }
    for part in [20, 25] {
        let mut graph = onnx::adding(&onnx::tensor(&[1], &[1.0]));
        graph.extend(onnx::bytes(part, b"any"));
        let error = Stranger::new().encoder(&graph).unwrap_err().to_string();
        assert!(error.contains("inside of the graph"), "{error}");
    }
}

#[test]
fn a_tensor_is_not_as_large_as_it_says() {
    for size in [1 << 60, 1 << 40, 1 << 33] {
        let graph = onnx::adding(&onnx::tensor(&[size], &[1.0]));
        let error = Stranger::new().encoder(&graph).unwrap_err();
        assert!(matches!(error, ModelError::Graph { .. }), "{error}");
    }
}

#[test]
fn what_is_no_graph_is_refused() {
    let whole = onnx::adding(&onnx::tensor(&[1], &[1.0]));
    let half = whole[..whole.len() / 2].to_vec();
    for graph in [half, b"not a graph at all".to_vec(), vec![0xff; 64]] {
        let error = Stranger::new().encoder(&graph).unwrap_err();
        assert!(matches!(error, ModelError::GraphFile { .. }), "{error}");
    }
}
