//! The fuzz targets `options`, `manifest` and `rig`, and what must hold for any bytes. Each
//! function returns whether it accepts the bytes. Not a part of the library.

use crate::{
    engine::{DEFAULT_BATCH, GenerationOptions},
    formats::{
        Character, Codes, GeneratedMotion, OutputFormat, PositionsSource, RigLimits, RigMapping,
        Timings,
    },
    model::Manifest,
    motion::{FinishOptions, Skeleton, finish},
    server::options::RequestOptions,
};

/// Longest answer to a wrong option: it never repeats a long value.
const LONGEST_ANSWER: usize = 1024;

/// Reads bytes as the query of a request to the model of `manifest`.
#[must_use]
pub fn options(bytes: &[u8], manifest: &Manifest) -> bool {
    let Ok(uri) = format!("/generate?{}", String::from_utf8_lossy(bytes)).parse() else {
        return false;
    };
    let options = match RequestOptions::from_query(&uri) {
        Ok(options) => options,
        Err(error) => return refused(&error),
    };
    let generation = options.generation(OutputFormat::Json);
    if let Some(tail) = &generation.continue_from {
        assert_eq!(tail.to_text().parse().ok().as_ref(), Some(tail));
    }
    let same = RequestOptions::default();
    assert!(options.written_as(&same).is_ok_and(|kept| kept == options));
    match generation.check(manifest, DEFAULT_BATCH.get()) {
        Ok(()) => true,
        Err(error) => refused(&error),
    }
}

fn refused(error: &dyn std::fmt::Display) -> bool {
    let answer = error.to_string();
    assert!(answer.len() <= LONGEST_ANSWER, "{answer}");
    false
}

/// Reads bytes as a manifest.
#[must_use]
pub fn manifest(bytes: &[u8]) -> bool {
    let Ok(manifest) = serde_json::from_slice::<Manifest>(bytes) else {
        return false;
    };
    if let Err(problem) = manifest.validate() {
        assert!(!problem.is_empty());
        return false;
    }
    assert!(manifest.decoded_columns() >= manifest.motion_columns());
    assert!(!manifest.skeleton.foot_joints().is_empty());
    let mut files = manifest.files.keys();
    assert!(files.all(|name| !name.contains(['/', '\\'])));
    let defaults = GenerationOptions::default();
    assert!(defaults.check(&manifest, DEFAULT_BATCH.get()).is_ok());
    let text = serde_json::to_vec(&manifest).unwrap_or_default();
    let again = serde_json::from_slice::<Manifest>(&text);
    assert!(again.is_ok_and(|again| again.validate().is_ok()));
    true
}

/// Reads bytes as a caller's character, and lets it dance.
#[must_use]
pub fn rig(bytes: &[u8]) -> bool {
    let limits = RigLimits { bytes: 1 << 20, bones: 2_000 };
    let read = |bytes: &[u8]| Character::read(bytes.to_vec(), &RigMapping::default(), &limits);
    let character = match read(bytes) {
        Ok(character) => character,
        Err(error) => return refused(&error),
    };
    let dance = dance();
    match character.dance(&dance, true) {
        Ok(file) => {
            assert!(file.len() <= character.most_bytes(dance.animation.root.len()));
            assert!(read(&file).is_ok_and(|again| again.mapping() == character.mapping()));
            true
        }
        Err(error) => refused(&error),
    }
}

/// A short dance of the joints of SMPL.
fn dance() -> GeneratedMotion {
    let joints = SMPL.map(|(name, _, _)| name.to_owned()).to_vec();
    let skeleton = Skeleton {
        joints,
        parents: SMPL.map(|(_, parent, _)| parent).to_vec(),
        offsets: SMPL.map(|(_, _, offset)| offset).to_vec(),
        root_height: 0.95,
    };
    let rows = ndarray::Array2::from_shape_fn((24, 72), |(row, column)| {
        let mut place = [0.0; 3];
        let mut at = column as i32 / 3;
        while at > 0 {
            let (_, parent, offset) = SMPL[at as usize];
            (0..3).for_each(|axis| place[axis] += offset[axis]);
            at = parent;
        }
        place[column % 3] + 0.05 * (row as f32 + column as f32).sin()
    });
    let finished = finish(rows.view(), &skeleton, &FinishOptions::default());
    let Ok(finished) = finished else { unreachable!("the rows are those of the skeleton") };
    GeneratedMotion {
        model: String::new(),
        seed: 0,
        skeleton,
        animation: finished.animation,
        positions: finished.positions,
        positions_source: PositionsSource::ForwardKinematics,
        codes: Codes::default(),
        style: None,
        music: None,
        timings: Timings::default(),
        warnings: Vec::new(),
        song_start_s: 0.0,
        continuation: None,
    }
}

/// Joints with parents and offsets, metres.
const SMPL: [(&str, i32, [f32; 3]); 24] = [
    ("pelvis", -1, [0.0, 0.0, 0.0]),
    ("l_hip", 0, [0.06, -0.09, 0.0]),
    ("r_hip", 0, [-0.06, -0.09, 0.0]),
    ("spine1", 0, [0.0, 0.12, -0.03]),
    ("l_knee", 1, [0.04, -0.39, 0.0]),
    ("r_knee", 2, [-0.04, -0.39, 0.0]),
    ("spine2", 3, [0.0, 0.14, 0.03]),
    ("l_ankle", 4, [-0.01, -0.42, -0.03]),
    ("r_ankle", 5, [0.01, -0.42, -0.03]),
    ("spine3", 6, [0.0, 0.06, 0.0]),
    ("l_foot", 7, [0.04, -0.06, 0.12]),
    ("r_foot", 8, [-0.04, -0.06, 0.12]),
    ("neck", 9, [0.0, 0.21, -0.03]),
    ("l_collar", 9, [0.07, 0.11, -0.02]),
    ("r_collar", 9, [-0.07, 0.11, -0.02]),
    ("head", 12, [0.0, 0.09, 0.05]),
    ("l_shoulder", 13, [0.12, 0.05, -0.02]),
    ("r_shoulder", 14, [-0.12, 0.05, -0.02]),
    ("l_elbow", 16, [0.26, -0.01, -0.02]),
    ("r_elbow", 17, [-0.26, -0.01, -0.02]),
    ("l_wrist", 18, [0.26, 0.01, 0.0]),
    ("r_wrist", 19, [-0.26, 0.01, 0.0]),
    ("l_hand", 20, [0.09, -0.01, -0.01]),
    ("r_hand", 21, [-0.09, -0.01, -0.01]),
];
