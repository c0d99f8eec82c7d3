//! `check-data`: finds mistakes in a folder of training data before hours are spent on it.

mod beats;
mod facts;
mod findings;
mod motions;
mod music;
mod options;
mod report;
mod songs;
mod splits;
mod topic;

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
};

use bailando::motion::{Positions, Skeleton};
use findings::Findings;
use glam::DVec3;

pub use findings::{Finding, Severity, Topic};
pub use options::CheckOptions;
pub use report::{Report, SplitSummary};

use super::{DataError, Dataset, MotionSource, Piece, Split, dataset::Absent};

/// Dances of a list that are named where they are not there.
const NAMED: usize = 3;

/// Checks the folder `root`.
///
/// # Errors
/// [`DataError`] where there is nothing to report on: no known layout, or an index that is no JSON.
/// Everything else is a [`Finding`].
pub fn check(root: &Path, options: &CheckOptions) -> Result<Report, DataError> {
    let dataset = Dataset::survey(root, &options.open)?;
    let mut findings = Findings::default();
    for defect in &dataset.defects {
        findings.add(Topic::Entry, format!("{}: {}", defect.piece, defect.what));
    }
    for note in &dataset.notes {
        findings.add(Topic::Layout, note.clone());
    }
    for Absent { split, named, ids } in &dataset.absent {
        let (count, some) = (ids.len(), ids.iter().take(NAMED).cloned().collect::<Vec<_>>());
        let more = if count > NAMED { ", .." } else { "" };
        let place = format!("{split}: {count} of {named}: {}{more}", some.join(", "));
        findings.add(Topic::Absent, place);
    }
    missing_files(&dataset, &mut findings);
    let mut by_motion: BTreeMap<&MotionSource, Vec<&Piece>> = BTreeMap::new();
    for piece in &dataset.pieces {
        by_motion.entry(&piece.motion).or_default().push(piece);
    }
    let mut frames: HashMap<&MotionSource, usize> = HashMap::new();
    for (source, pieces) in &by_motion {
        if source.path().is_file()
            && let Some(found) = motions::check(source, pieces, &dataset.skeleton, &mut findings)
        {
            frames.insert(source, found);
        }
    }
    let tracked = music::check(&dataset, &frames, options, &mut findings);
    splits::check(&dataset, &frames, &tracked, &mut findings);
    Ok(Report {
        folder: root.to_owned(),
        layout: dataset.layout.to_string(),
        splits: [Split::Train, Split::Test]
            .map(|split| report::summary(&dataset, split, &frames))
            .to_vec(),
        motions_checked: by_motion.len(),
        songs_decoded: tracked.len(),
        beats_compared: tracked
            .values()
            .filter(|song| song.as_ref().is_ok_and(|song| song.beats.is_some()))
            .count(),
        findings: findings.into_list(),
    })
}

/// Returns the mean direction from feet to head.
pub(super) fn up_direction(positions: &Positions, skeleton: &Skeleton) -> DVec3 {
    facts::measure(positions, skeleton).up
}

fn missing_files(dataset: &Dataset, findings: &mut Findings) {
    for piece in &dataset.pieces {
        let music = piece.music.as_ref().map(|music| music.path());
        for path in [Some(piece.motion.path()), music].into_iter().flatten() {
            if !path.is_file() {
                let name = path.strip_prefix(&dataset.root).unwrap_or(path);
                let place = format!("{}: {}", piece.id, name.display());
                findings.add(Topic::MissingFile, place);
            }
        }
    }
}

#[cfg(test)]
mod tests;
