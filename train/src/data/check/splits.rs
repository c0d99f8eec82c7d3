//! Splits and duplicates: what is in both splits, and what is there more than once.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use bailando::model::file_sha256;

use super::{
    findings::{Findings, Topic, file_name},
    motions::CROP,
    songs::Songs,
};
use crate::data::{Dataset, MotionSource, MusicSource, Piece, Split};

type Names = BTreeMap<Split, BTreeSet<String>>;

pub(super) fn check(
    dataset: &Dataset,
    frames: &HashMap<&MotionSource, usize>,
    tracked: &Songs,
    findings: &mut Findings,
) {
    let usable = |split| {
        dataset.pieces.iter().any(|piece| {
            piece.split == split && frames.get(&piece.motion).is_some_and(|&n| n >= CROP)
        })
    };
    if !usable(Split::Train) {
        findings.add(Topic::NoTraining, format!("{} pieces looked at", dataset.pieces.len()));
    }
    if !dataset.pieces.iter().any(|piece| piece.split == Split::Test) {
        findings.add(Topic::NoTest, format!("{} pieces looked at", dataset.pieces.len()));
    }
    check_motions(dataset, findings);
    check_songs(dataset, tracked, findings);
    check_recordings(dataset, findings);
    check_pieces(dataset, findings);
}

fn check_motions(dataset: &Dataset, findings: &mut Findings) {
    let mut hashes: HashMap<&MotionSource, Option<String>> = HashMap::new();
    let mut by_content: BTreeMap<String, Names> = BTreeMap::new();
    for piece in &dataset.pieces {
        let hash = hashes.entry(&piece.motion).or_insert_with(|| {
            let file = std::fs::File::open(piece.motion.path());
            let hash = file.and_then(|mut file| file_sha256(&mut file));
            // Files that cannot be read are reported elsewhere.
            hash.ok()
        });
        if let Some(hash) = hash {
            note(by_content.entry(hash.clone()).or_default(), piece.split, &piece.motion);
        }
    }
    for names in by_content.values() {
        match both(names) {
            Some(place) => findings.add(Topic::Leak, place),
            None => copies(names, findings),
        }
    }
}

fn note(names: &mut Names, split: Split, motion: &MotionSource) {
    names.entry(split).or_default().insert(file_name(motion.path()));
}

fn check_songs(dataset: &Dataset, tracked: &Songs, findings: &mut Findings) {
    let mut by_content: BTreeMap<&str, Names> = BTreeMap::new();
    for piece in &dataset.pieces {
        if let Some(MusicSource::Audio(path)) = &piece.music
            && let Some(Ok(song)) = tracked.get(path)
        {
            let names = by_content.entry(song.hash.as_str()).or_default();
            names.entry(piece.split).or_default().insert(file_name(path));
        }
    }
    for names in by_content.values() {
        match both(names) {
            Some(place) => findings.add(Topic::SharedSong, place),
            None => copies(names, findings),
        }
    }
}

fn check_recordings(dataset: &Dataset, findings: &mut Findings) {
    let mut by_source: BTreeMap<&str, Names> = BTreeMap::new();
    for piece in &dataset.pieces {
        if let Some(source) = &piece.source {
            note(by_source.entry(source).or_default(), piece.split, &piece.motion);
        }
    }
    for (source, names) in by_source {
        // The same file in both is a leak, and reported as such.
        let train = names.get(&Split::Train);
        let test = names.get(&Split::Test);
        if let (Some(train), Some(test)) = (train, test)
            && train.is_disjoint(test)
        {
            findings.add(Topic::SharedRecording, format!("{source}: {}", places(train, test)));
        }
    }
}

fn check_pieces(dataset: &Dataset, findings: &mut Findings) {
    let mut ids = BTreeMap::new();
    let mut pairs: BTreeMap<_, &Piece> = BTreeMap::new();
    for piece in &dataset.pieces {
        *ids.entry(&piece.id).or_insert(0_usize) += 1;
        if let Some(first) = pairs.insert((&piece.motion, &piece.music, piece.split), piece)
            && first.id != piece.id
        {
            let place = format!("{} and {}: the same motion and song", first.id, piece.id);
            findings.add(Topic::Duplicate, place);
        }
    }
    for (id, count) in ids.into_iter().filter(|&(_, count)| count > 1) {
        findings.add(Topic::DuplicateId, format!("{id}: {count} times"));
    }
}

/// One line when both splits have names.
fn both(names: &Names) -> Option<String> {
    Some(places(names.get(&Split::Train)?, names.get(&Split::Test)?))
}

fn places(train: &BTreeSet<String>, test: &BTreeSet<String>) -> String {
    let list = |names: &BTreeSet<String>| names.iter().cloned().collect::<Vec<_>>().join(", ");
    format!("train: {}; test: {}", list(train), list(test))
}

fn copies(names: &Names, findings: &mut Findings) {
    for names in names.values().filter(|names| names.len() > 1) {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        findings.add(Topic::Duplicate, format!("{}: the same content", names.join(", ")));
    }
}
