//! Judging music: decodable, audible, as long as the dance, beats where the grid says.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
};

use super::{
    beats,
    findings::{Findings, Topic, file_name},
    options::CheckOptions,
    songs::{Songs, track},
};
use crate::data::{Dataset, Layout, MotionSource, MusicSource, Piece, json};
use bailando::features::Rate;

/// Root mean square below which a song is silence: -80 dB.
const SILENCE: f64 = 1e-4;
/// Tracked beats are always about 28 ms late (onset envelope, FEATURES section 8).
const DETECTOR_LATE_S: f64 = 0.028;
/// Seconds by which a grid may be off.
const GRID_TOLERANCE_S: f64 = 0.07;
/// Seconds by which song and motion may differ in length.
const LENGTH_TOLERANCE_S: f64 = 0.5;
/// Frame rates that motions come in where they were not brought to 60.
const OTHER_RATES: [f64; 6] = [24.0, 25.0, 30.0, 50.0, 100.0, 120.0];

/// Checks all music; returns the measures.
pub(super) fn check(
    dataset: &Dataset,
    frames: &HashMap<&MotionSource, usize>,
    options: &CheckOptions,
    findings: &mut Findings,
) -> Songs {
    let mut by_song: BTreeMap<&Path, Vec<&Piece>> = BTreeMap::new();
    let mut silent_pieces = Vec::new();
    for piece in &dataset.pieces {
        match &piece.music {
            Some(MusicSource::Audio(path)) if path.is_file() => {
                by_song.entry(path).or_default().push(piece);
            }
            Some(MusicSource::Audio(_)) => {}
            Some(MusicSource::DanceRows(path) | MusicSource::Rows(path)) => {
                check_rows(path, &piece.id, findings);
            }
            None => silent_pieces.push(piece.id.as_str()),
        }
    }
    if !silent_pieces.is_empty() {
        let (count, all) = (silent_pieces.len(), dataset.pieces.len());
        findings.add(Topic::NoMusic, format!("{count} of {all} pieces"));
    }
    let tracked = track(&chosen(&by_song, options));
    for (path, pieces) in &by_song {
        match tracked.get(*path) {
            Some(Ok(song)) => {
                let name = file_name(path);
                if song.level < SILENCE {
                    findings.add(Topic::Silent, name);
                    continue;
                }
                for piece in pieces {
                    check_length(dataset, piece, song.seconds, frames, findings);
                }
                if let (Some(tracked), Some(piece)) = (&song.beats, pieces.first()) {
                    check_grid(piece, tracked, &name, findings);
                }
            }
            Some(Err(problem)) => findings.add(Topic::AudioFile, problem.clone()),
            None => {}
        }
    }
    tracked
}

/// The songs to decode, and which of them to find beats in: spread evenly over the list.
fn chosen<'p>(
    songs: &BTreeMap<&'p Path, Vec<&Piece>>,
    options: &CheckOptions,
) -> Vec<(&'p Path, bool)> {
    let count = songs.len();
    let decoded = options.songs.unwrap_or(count).min(count);
    let paths = songs.keys().enumerate();
    paths
        .filter(|(index, _)| is_picked(*index, decoded, count))
        .enumerate()
        .map(|(index, (_, path))| (*path, is_picked(index, options.beats, decoded)))
        .collect()
}

/// Whether the item `index` is among the `wanted` that lie most evenly in `count`.
pub(super) fn is_picked(index: usize, wanted: usize, count: usize) -> bool {
    let picked_before = |index: usize| index * wanted.min(count) / count.max(1);
    picked_before(index + 1) > picked_before(index)
}

fn check_rows(path: &Path, id: &str, findings: &mut Findings) {
    match json::rows(path) {
        Err(error) => findings.add(Topic::AudioFile, error.to_string()),
        Ok((rows, _)) if rows.iter().any(|value| !value.is_finite()) => {
            findings.add(Topic::NotFinite, format!("{id}: music_array"));
        }
        Ok((_, Rate::Beats)) => findings.add(Topic::StoredRows, id.to_owned()),
        Ok((_, Rate::Conditioning)) => {}
    }
}

fn check_length(
    dataset: &Dataset,
    piece: &Piece,
    seconds: f64,
    frames: &HashMap<&MotionSource, usize>,
    findings: &mut Findings,
) {
    let Some(&frames) = frames.get(&piece.motion) else {
        return;
    };
    let dance = frames as f64 / 60.0;
    if (seconds - dance).abs() <= LENGTH_TOLERANCE_S {
        return;
    }
    let id = &piece.id;
    let what = format!("{id}: the dance lasts {dance:.2} s, the song {seconds:.2} s");
    // Elsewhere songs are whole and motions are parts of them.
    let cut_to_fit = dataset.layout == Layout::Folder;
    let rate = frames as f64 / seconds.max(1e-9);
    let other = OTHER_RATES.iter().find(|other| (rate / **other - 1.0).abs() < 0.01);
    match other {
        Some(other) if cut_to_fit => {
            findings.add(Topic::FrameRate, format!("{what}: {other} frames a second would fit"))
        }
        _ if cut_to_fit || seconds < dance => findings.add(Topic::AudioLength, what),
        _ => {}
    }
}

fn check_grid(piece: &Piece, tracked: &[f64], name: &str, findings: &mut Findings) {
    if tracked.is_empty() {
        findings.add(Topic::NoBeats, name.to_owned());
        return;
    }
    let Some(fit) = beats::fit(&piece.grid_beats_s, tracked) else {
        return;
    };
    let id = &piece.id;
    let late = fit.late_s - DETECTOR_LATE_S;
    if fit.is_chance() {
        let together = fit.together;
        findings.add(Topic::Grid, format!("{id} with {name}: agreement {together:.2} of 1"));
    } else if late.abs() > GRID_TOLERANCE_S {
        let milliseconds = 1_000.0 * late.abs();
        let side = if late > 0.0 { "early" } else { "late" };
        let half = if fit.late_s.abs() > 0.4 * fit.period_s {
            " (half a beat: the tracked beats may be the off-beats)"
        } else {
            ""
        };
        findings.add(
            Topic::GridOffset,
            format!("{id} with {name}: the grid is {milliseconds:.0} ms {side}{half}"),
        );
    }
}
