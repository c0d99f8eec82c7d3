//! `convert`: motion capture as a data folder of our own.
//!
//! Every motion is put on our skeleton, turned upright, brought to 60 frames a second and stood on
//! the floor. BVH is retargeted by the directions of its bones, rotations of body models are taken
//! as they are.

mod amass;
mod bvh;
mod recorded;
mod rig;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use bailando::motion::{Positions, Skeleton};
use clap::Args;
use serde_json::{Value, json};

use super::{
    DataError, FPS, Split, files,
    folder::{INDEX, ROOT_HEIGHT},
    smpl,
    songs::Songs,
};
use crate::export::skeleton;
use recorded::Recorded;

/// What is converted.
const MOTIONS: [&str; 3] = ["bvh", "npz", "pkl"];

/// The motion capture to convert, and the folder to write.
#[derive(Args, Clone, Debug)]
pub struct ConvertOptions {
    /// Files (.bvh, .npz as AMASS has, .pkl with SMPL rotations) and folders of them
    #[arg(required = true, value_name = "PATH")]
    pub inputs: Vec<PathBuf>,
    /// Data folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Folder of the songs: each is copied beside the motion of its name
    #[arg(long, value_name = "DIR")]
    pub audio: Option<PathBuf>,
    /// A motion for the split test, by the name of its file; may be repeated. All others train
    #[arg(long, value_name = "NAME")]
    pub test: Vec<String>,
}

/// What became of them.
#[derive(Debug)]
#[non_exhaustive]
pub struct Converted {
    /// Motions written.
    pub motions: usize,
    /// How many of them have a song.
    pub songs: usize,
    /// Why the others were left out.
    pub refused: Vec<DataError>,
}

/// Writes `index.json`, a `.npy` for every motion, and copies of the songs. A file that cannot be
/// converted is left out.
///
/// # Errors
/// [`DataError`]: nothing to convert, a folder that has data already, a song folder or an output
/// that does not work.
pub fn convert(options: &ConvertOptions) -> Result<Converted, DataError> {
    let out = &options.out;
    if out.join(INDEX).exists() {
        return Err(DataError::Exists(out.clone()));
    }
    let mut songs = Songs::default();
    if let Some(folder) = &options.audio {
        songs.add_audio(folder)?;
    }
    let (inputs, mut refused) = inputs(&options.inputs)?;
    if let Some(name) = options.test.iter().find(|name| !inputs.contains_key(*name)) {
        return Err(DataError::NoSuchTest(name.clone()));
    }
    fs::create_dir_all(out).map_err(files::failed(out))?;
    let skeleton = skeleton(ROOT_HEIGHT);
    let mut pieces = Vec::new();
    let mut copied = BTreeSet::new();
    for (id, path) in &inputs {
        let positions = match positions(path, &skeleton) {
            Ok(positions) => positions,
            Err(error) => {
                refused.push(error);
                continue;
            }
        };
        let split = if options.test.contains(id) { Split::Test } else { Split::Train };
        let mut piece = written(out, id, split, &positions)?;
        if let Some(song) = songs.of(id) {
            let name = song.file_name().unwrap_or_default();
            if copied.insert(name.to_owned()) {
                fs::copy(song, out.join(name)).map_err(files::failed(song))?;
            }
            piece["audio"] = name.to_string_lossy().into();
        }
        pieces.push(piece);
    }
    let with_song = pieces.iter().filter(|piece| piece.get("audio").is_some()).count();
    let converted = Converted { motions: pieces.len(), songs: with_song, refused };
    if converted.motions > 0 {
        write_index(out, &skeleton, pieces)?;
    }
    Ok(converted)
}

/// The motions by the names of their files; of one name, the first.
fn inputs(paths: &[PathBuf]) -> Result<(BTreeMap<String, PathBuf>, Vec<DataError>), DataError> {
    let mut waiting: Vec<PathBuf> = paths.iter().rev().cloned().collect();
    let (mut found, mut refused) = (BTreeMap::new(), Vec::new());
    while let Some(path) = waiting.pop() {
        if path.is_dir() {
            waiting.extend(files::list(&path)?.into_iter().rev());
        } else if files::has_extension(&path, &MOTIONS) {
            match found.get(&files::stem(&path)) {
                Some(other) => {
                    refused.push(DataError::SameName { path, other: PathBuf::clone(other) })
                }
                None => drop(found.insert(files::stem(&path), path)),
            }
        } else if paths.contains(&path) {
            return Err(DataError::NoMotion(path));
        }
    }
    match (paths.first(), found.is_empty()) {
        (Some(path), true) => Err(DataError::NoMotion(path.clone())),
        _ => Ok((found, refused)),
    }
}

/// Reads a motion as joints `[frames, 24, 3]` on the floor, 60 frames a second.
fn positions(path: &Path, skeleton: &Skeleton) -> Result<Positions, DataError> {
    let recorded = if files::has_extension(path, &["bvh"]) {
        bvh::read(path, skeleton)
    } else if files::has_extension(path, &["npz"]) {
        amass::read(path)
    } else {
        let (animation, rate) = smpl::rotations(path)?;
        Ok(Recorded { animation, rate: rate.unwrap_or(FPS as f64) })
    };
    recorded?.stand(path, skeleton)
}

/// Writes the motion; returns its entry of the index.
fn written(out: &Path, id: &str, split: Split, positions: &Positions) -> Result<Value, DataError> {
    let name = format!("{id}.npy");
    let path = out.join(&name);
    ndarray_npy::write_npy(&path, positions)
        .map_err(|error| DataError::Shape { path, what: error.to_string() })?;
    let frames = positions.dim().0;
    let seconds = frames as f64 / FPS as f64;
    Ok(json!({
        "id": id, "split": split.to_string(), "motion": name, "frames": frames, "seconds": seconds,
    }))
}

fn write_index(out: &Path, skeleton: &Skeleton, pieces: Vec<Value>) -> Result<(), DataError> {
    let Skeleton { joints, parents, offsets, .. } = skeleton;
    let index = json!({
        "joints": joints, "parents": parents, "offsets": offsets, "fps": FPS, "pieces": pieces,
    });
    let path = out.join(INDEX);
    fs::write(&path, format!("{index:#}\n")).map_err(files::failed(&path))
}

#[cfg(test)]
mod tests;
