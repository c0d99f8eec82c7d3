use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt};

use crate::{Files, JobsError, files::missing};

fn large() -> Bytes {
    (0..12_000_000_u32).map(|i| (i % 251) as u8).collect()
}

async fn read(files: &Files, name: &str, range: Option<std::ops::Range<u64>>) -> (u64, Vec<u8>) {
    let (size, pieces) = files.read(name, range).await.unwrap();
    let pieces: Vec<Bytes> = pieces.try_collect().await.unwrap();
    (size, pieces.concat())
}

async fn written_read_and_deleted(files: &Files) {
    let bytes = large();
    let mut writer = files.write("results/a/1.motion");
    for piece in bytes.chunks(700_001) {
        writer.push(Bytes::copy_from_slice(piece)).await.unwrap();
        assert!(matches!(
            files.read_whole("results/a/1.motion").await,
            Err(JobsError::NoFile { .. })
        ));
    }
    assert_eq!(writer.finish().await.unwrap(), bytes.len() as u64);
    assert_eq!(files.read_whole("results/a/1.motion").await.unwrap(), bytes);
    let (size, part) = read(files, "results/a/1.motion", Some(5..9)).await;
    assert_eq!((size, &part[..]), (bytes.len() as u64, &bytes[5..9]));
    files.put("results/b/1.json", Bytes::from_static(b"{}")).await.unwrap();
    files.copy("results/b/1.json", "results/a/1.json").await.unwrap();
    let old = files.older_than("results", Duration::ZERO);
    tokio::time::sleep(Duration::from_millis(5)).await;
    let mut old: Vec<String> = old.try_collect().await.unwrap();
    old.sort();
    assert!(old.len() <= 3);
    assert_eq!(files.older_than("results", Duration::from_secs(60)).count().await, 0);
    assert_eq!(files.delete_below("results/a").await.unwrap(), 2);
    assert_eq!(files.delete_below("results/a").await.unwrap(), 0);
    assert_eq!(files.read_whole("results/b/1.json").await.unwrap(), "{}");
    let mut given_up = files.write("results/c");
    given_up.push(large()).await.unwrap();
    drop(given_up);
    assert!(matches!(files.copy("results/c", "d").await, Err(JobsError::NoFile { .. })));
}

#[tokio::test(flavor = "multi_thread")]
async fn files_are_whole_or_not_there() {
    written_read_and_deleted(&Files::in_memory()).await;
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("new/files");
    let files = Files::in_folder(&place).unwrap();
    written_read_and_deleted(&files).await;
    let left = || -> Vec<_> {
        let left = fs::read_dir(place.join("results")).unwrap();
        left.map(|entry| entry.unwrap().file_name()).collect()
    };
    // What was given up is deleted in the background.
    let until = Instant::now() + Duration::from_secs(20);
    while left() != ["b"] && Instant::now() < until {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(left(), ["b"], "an empty folder is one file more for ever");
}

#[test]
fn a_folder_that_cannot_be_written_to_is_named() {
    // Also for root, whom no permission stops.
    let refused = Files::in_folder(Path::new("/proc/nothing")).unwrap_err().to_string();
    assert!(refused.contains("/proc/nothing"), "{refused}");
    let refused = Files::at_url("ftp://host/x").unwrap_err().to_string();
    assert!(refused.contains("s3://"), "{refused}");
}

#[test]
fn what_a_killed_process_left_is_deleted_by_its_age() {
    let folder = tempfile::tempdir().unwrap();
    let files = Files::in_folder(folder.path()).unwrap();
    let below = folder.path().join("songs");
    let empty = folder.path().join("empty");
    [&below, &empty].into_iter().for_each(|folder| fs::create_dir(folder).unwrap());
    for name in ["half#1", "whole", "odd#name"] {
        fs::write(below.join(name), b"x").unwrap();
    }
    files.delete_fragments(Duration::from_secs(60));
    assert!(below.join("half#1").exists() && empty.exists());
    std::thread::sleep(Duration::from_millis(20));
    files.delete_fragments(Duration::from_millis(5));
    assert!(!below.join("half#1").exists() && !empty.exists());
    assert!(below.join("whole").exists() && below.join("odd#name").exists());
}

/// A disk that is full: as `/dev/full`, but for a whole folder, is not to be had without a mount.
#[tokio::test]
async fn a_store_that_is_gone_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("files");
    let files = Files::in_folder(&place).unwrap();
    fs::remove_dir_all(&place).unwrap();
    fs::write(&place, b"a file in the folder's place").unwrap();
    let failed = files.put("songs/x", Bytes::from_static(b"x")).await.unwrap_err();
    assert!(matches!(failed, JobsError::Store(_)), "{failed}");
}

/// As S3 answers for a file that is not there, and for any file of a bucket that is gone.
#[test]
fn a_bucket_that_is_gone_is_no_missing_file() {
    for (code, lasting) in [("NoSuchKey", true), ("NoSuchBucket", false)] {
        let source = format!("404 Not Found: <Error><Code>{code}</Code></Error>").into();
        let answer = object_store::Error::NotFound { path: "jobs/a/song".to_owned(), source };
        let error = missing(answer, "jobs/a/song");
        assert_eq!(error.is_lasting(), lasting, "{error}");
    }
}
