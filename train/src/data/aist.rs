//! AIST++: one `.pkl` motion per dance, lists of splits, songs in a folder of their own.

use std::{
    collections::{BTreeSet, HashSet},
    path::{Path, PathBuf},
};

use super::{
    DataError, Dataset, Layout, MotionSource, MusicSource, Split, dataset::Absent, files,
    folder::ROOT_HEIGHT, json::bare_piece, songs::Songs,
};
use crate::export::skeleton;

const PICKLES: [&str; 1] = ["pkl"];
/// Lists of the published splits. The published test set of 40 dances is test and validation.
const TRAIN_LISTS: [&str; 2] = ["crossmodal_train.txt", "train.txt"];
const TEST_LISTS: [&str; 4] = ["crossmodal_test.txt", "crossmodal_val.txt", "test.txt", "val.txt"];
/// Motions whose reconstruction the authors of AIST++ found to have failed.
const IGNORED: &str = "ignore_list.txt";

/// The motions in `root/motions` or `root`; none where there is no pickle.
pub(super) fn motions(root: &Path) -> Result<Option<Vec<PathBuf>>, DataError> {
    let inside = root.join("motions");
    let folder = if inside.is_dir() { &inside } else { root };
    let mut motions = files::list(folder)?;
    motions.retain(|path| files::has_extension(path, &PICKLES));
    Ok(Some(motions).filter(|motions| !motions.is_empty()))
}

pub(super) fn read(
    root: &Path,
    motions: &[PathBuf],
    audio: Option<&Path>,
) -> Result<Dataset, DataError> {
    let songs = Songs::audio(root, audio)?;
    let train = ids(root, &TRAIN_LISTS)?;
    let test = ids(root, &TEST_LISTS)?;
    let ignored = ids(root, &[IGNORED])?;
    let listed = !train.is_empty() || !test.is_empty();
    let (mut pieces, mut skipped, mut unlisted) = (Vec::new(), 0, 0);
    for path in motions {
        let id = files::stem(path);
        if ignored.contains(&id) {
            skipped += 1;
            continue;
        }
        let split = match (test.contains(&id), train.contains(&id) || !listed) {
            (true, _) => Split::Test,
            (false, true) => Split::Train,
            (false, false) => {
                unlisted += 1;
                continue;
            }
        };
        let music = songs.of(&id).cloned().map(MusicSource::Audio);
        pieces.push(bare_piece(id, split, MotionSource::Pickle(path.clone()), music));
    }
    let there: HashSet<String> = motions.iter().map(|path| files::stem(path)).collect();
    let absent = [(Split::Train, &train), (Split::Test, &test)].map(|(split, named)| {
        let named: BTreeSet<&String> = named.difference(&ignored).collect();
        let ids = named.iter().filter(|id| !there.contains(**id)).map(|id| (*id).clone());
        Absent { split, named: named.len(), ids: ids.collect() }
    });
    let mut notes = Vec::new();
    if !listed {
        notes.push(
            "there are no lists of splits (splits/crossmodal_train.txt, ..): all dances are \
                    taken for training"
                .into(),
        );
    }
    if unlisted > 0 {
        notes.push(format!("{unlisted} dances are in no list of splits and are left out"));
    }
    if skipped > 0 {
        notes.push(format!("{skipped} dances of {IGNORED} are left out"));
    }
    Ok(Dataset {
        root: root.to_owned(),
        layout: Layout::Aist,
        skeleton: skeleton(ROOT_HEIGHT),
        pieces,
        defects: Vec::new(),
        absent: absent.into_iter().filter(|absent| !absent.ids.is_empty()).collect(),
        notes,
    })
}

/// The ids in those of the lists that are there, in `root` or `root/splits`.
fn ids(root: &Path, lists: &[&str]) -> Result<HashSet<String>, DataError> {
    let mut ids = HashSet::new();
    for folder in [root.to_owned(), root.join("splits")] {
        for list in lists {
            let path = folder.join(list);
            if path.is_file() {
                let bytes = files::read(&path)?;
                let text = String::from_utf8_lossy(&bytes);
                ids.extend(text.split_whitespace().map(str::to_owned));
            }
        }
    }
    Ok(ids)
}
