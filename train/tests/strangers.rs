//! Checkpoints from strangers: nothing in them runs, and nothing is allocated because they say so.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use crate::common::fixture;
use bailando_train::checkpoint::TorchCheckpoint;

/// A legacy container: magic number, version, system, object, storages.
fn legacy(object: &[u8], storages: &[(&str, i64, &[u8])]) -> Vec<u8> {
    let mut file = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.".to_vec();
    file.extend(b"\x80\x02M\xe9\x03.\x80\x02}X\x0d\x00\x00\x00little_endian\x88s.\x80\x02");
    file.extend(object);
    file.extend(b"\x80\x02](");
    for (key, ..) in storages {
        file.extend(text(key));
    }
    file.extend(b"e.");
    for (_, values, bytes) in storages {
        file.extend(values.to_le_bytes());
        file.extend(*bytes);
    }
    file
}

/// BINUNICODE.
fn text(text: &str) -> Vec<u8> {
    let length = u32::try_from(text.len()).unwrap();
    [b"X", &length.to_le_bytes()[..], text.as_bytes()].concat()
}

/// LONG1 of eight bytes.
fn long(value: i64) -> Vec<u8> {
    [b"\x8a\x08", &value.to_le_bytes()[..]].concat()
}

/// `{name: tensor}` whose storage `7` and whose one dimension have so many values.
fn tensor(name: &str, values: i64) -> Vec<u8> {
    let mut pickle = b"}".to_vec();
    pickle.extend(text(name));
    pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
    pickle.extend([text("storage"), b"ctorch\nFloatStorage\n".to_vec()].concat());
    pickle.extend([text("7"), text("cpu"), long(values), b"tQK\x00".to_vec()].concat());
    pickle.extend([long(values), b"\x85K\x01\x85\x89)tRs.".to_vec()].concat());
    pickle
}

/// Imports `checkpoint` as both files, with 4 GiB of address space.
fn import(folder: &Path, checkpoint: &Path) -> Output {
    let mut shell = Command::new("sh");
    shell
        .args(["-c", "ulimit -v 4194304; exec \"$0\" \"$@\""])
        .arg(env!("CARGO_BIN_EXE_bailando-train"))
        .arg("import")
        .args([Path::new("--vqvae"), checkpoint, Path::new("--gpt"), checkpoint])
        .arg("--out")
        .arg(folder.join("model"));
    shell.output().unwrap()
}

#[test]
fn nothing_in_a_checkpoint_runs() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("mark");
    let command = text(&format!("touch {}", mark.display()));
    let python = text(&format!("open({:?}, 'w')", mark.display().to_string()));
    let with = |before: &[u8], argument: &[u8], after: &[u8]| [before, argument, after].concat();
    for object in [
        with(b"cposix\nsystem\n", &command, b"\x85R."),
        with(b"cos\nsystem\n(", &command, b"tR."),
        with(b"c__builtin__\nopen\n(", &text(mark.to_str().unwrap()), b"X\x01\x00\x00\x00wtR."),
        with(b"cbuiltins\neval\n", &python, b"\x85R."),
        with(b"csubprocess\nPopen\n(", &command, b"t\x81."),
        with(b"(", &command, b"ios\nsystem\n."),
        with(b"(cos\nsystem\n", &command, b"o."),
        with(b"csite\nmain\n)\x81}(X\x0c\x00\x00\x00__setstate__cos\nsystem\nub", &command, b"b."),
        // Beside a tensor that is read.
        with(
            &with(b"}(X\x01\x00\x00\x00acos\nsystem\n", &command, b"\x85R"),
            &tensor("b", 1)[1..],
            b"",
        )
        .strip_suffix(b"s.")
        .map(|start| [start, b"u."].concat())
        .unwrap(),
    ] {
        let file = legacy(&object, &[]);
        let opened = TorchCheckpoint::from_bytes(Path::new("x.pt"), file.clone());
        if let Ok(mut checkpoint) = opened {
            let names: Vec<String> = checkpoint.names().map(str::to_owned).collect();
            for name in names {
                let _ = checkpoint.tensor(&name);
            }
        }
        let path = folder.path().join("x.pt");
        fs::write(&path, file).unwrap();
        let output = import(folder.path(), &path);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        assert!(!mark.exists(), "{object:?} ran");
    }
}

#[test]
fn a_tensor_is_not_as_large_as_it_says() {
    const NAME: &str = "gpt_base.tok_emb_up.weight";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.pt");
    for values in [1 << 60, 1 << 40, 1 << 33, i64::MAX] {
        for said in [values, 1] {
            let file = legacy(&tensor(NAME, values), &[("7", said, &[0; 4])]);
            fs::write(&path, &file).unwrap();
            let opened = TorchCheckpoint::from_bytes(Path::new("x.pt"), file);
            let read = opened.and_then(|mut checkpoint| checkpoint.tensor(NAME));
            let error = read.unwrap_err().to_string();
            let refusals = ["should have", "list of storages", "hold more than"];
            assert!(refusals.iter().any(|refusal| error.contains(refusal)), "{error}");
            let output = import(folder.path(), &path);
            let said = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(1), "{said}");
            assert_eq!(said.lines().count(), 1, "{said}");
        }
    }
}

#[test]
fn a_zip_may_not_be_larger_than_it_is() {
    let file = fs::read(fixture("tiny_gpt.pt")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.pt");
    // Every size in the central directory, one after another, says 4 GiB.
    let heads: Vec<usize> =
        (0..file.len() - 4).filter(|&at| file[at..].starts_with(b"PK\x01\x02")).collect();
    assert!(heads.len() > 10);
    let mut all = file;
    for at in heads {
        all[at + 20..at + 28].copy_from_slice(&[0xfe, 0xff, 0xff, 0xff, 0xfe, 0xff, 0xff, 0xff]);
    }
    fs::write(&path, all).unwrap();
    let output = import(folder.path(), &path);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
}
