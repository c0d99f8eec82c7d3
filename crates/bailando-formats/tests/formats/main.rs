//! Motions as files: their contents, and reading them back.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test says what is wrong by failing"
)]

mod bvh;
mod bvh_readers;
mod fbx;
mod glb;
mod research;
mod rigs;
mod stored;
mod vmd;

use bailando_formats::{
    BvhUnit, Encoding, GeneratedMotion, JsonOptions, OutputFormat, TargetSkeleton, WriteOptions,
    to_bvh, to_json,
};
use bailando_motion::FinishOptions;
use bailando_testkit::motion::{dance_of, decoded_from, fixture, recordings};
use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::Value;

fn motion(fps: u32) -> GeneratedMotion {
    let options = FinishOptions { fps, ..FinishOptions::default() };
    dance_of(&fixture("decode_raw.npy"), &options)
}

fn short(frames: usize) -> GeneratedMotion {
    let decoded = fixture("decode_raw.npy");
    let rows = decoded.slice_axis(ndarray::Axis(0), (..frames).into());
    dance_of(&rows.to_owned(), &FinishOptions::default())
}

/// Up to half a minute of three recordings of dancers, with their names; none without the shared
/// data.
fn recorded(fps: u32) -> Vec<(String, GeneratedMotion)> {
    finished(FinishOptions { fps, ..FinishOptions::default() })
}

fn finished(options: FinishOptions) -> Vec<(String, GeneratedMotion)> {
    let Some(folder) = bailando_testkit::shared("data/salsa") else {
        println!("skipped: this test needs the shared data");
        return Vec::new();
    };
    let motion = |(path, positions): (std::path::PathBuf, ndarray::Array3<f32>)| {
        let frames = positions.dim().0.min(1800);
        let decoded =
            decoded_from(&positions.slice_axis(ndarray::Axis(0), (..frames).into()).to_owned());
        (path.file_stem().unwrap().display().to_string(), dance_of(&decoded, &options))
    };
    recordings(&folder).into_iter().take(3).map(motion).collect()
}

fn json(motion: &GeneratedMotion, options: JsonOptions) -> Value {
    serde_json::from_slice(&to_json(motion, &options).unwrap()).unwrap()
}

const WITH_ROTATIONS: JsonOptions = JsonOptions { rotations: true, encoding: Encoding::Json };

#[test]
fn json_has_the_documented_shape() {
    let mut value = json(&short(2), WITH_ROTATIONS);
    for array in ["positions", "rotations"] {
        for frame in value[array].as_array_mut().unwrap() {
            assert_eq!(frame.as_array().unwrap().len(), 24);
            frame.as_array_mut().unwrap().truncate(1);
        }
    }
    // The next test checks the numbers.
    for array in ["positions", "rotations", "root"] {
        without_digits(&mut value[array]);
    }
    for list in ["joints", "parents", "offsets"] {
        assert_eq!(value["skeleton"][list].as_array().unwrap().len(), 24);
        value["skeleton"][list].as_array_mut().unwrap().truncate(2);
    }
    insta::assert_json_snapshot!(value);
}

/// Keeps two decimals of every number: the last ones may differ between processors.
fn without_digits(value: &mut Value) {
    match value {
        Value::Array(values) => values.iter_mut().for_each(without_digits),
        _ => *value = format!("{:.2}", value.as_f64().unwrap()).into(),
    }
}

#[test]
fn rotations_and_music_are_absent_unless_there() {
    let mut motion = short(1);
    (motion.music, motion.style) = (None, None);
    let value = json(&motion, JsonOptions::default());
    for key in ["rotations", "root", "music", "style"] {
        assert!(value.get(key).is_none(), "{key}");
    }
}

/// All numbers in nested arrays, in order.
fn flat(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(values) => values.iter().flat_map(flat).collect(),
        _ => vec![value.as_f64().unwrap()],
    }
}

/// The arrays of a motion as they are written, in order.
fn arrays(motion: &GeneratedMotion) -> [(&'static str, Vec<f32>); 3] {
    let rotations = motion.animation.rotations.iter().flatten();
    let root = motion.animation.root.iter();
    [
        ("positions", motion.positions.iter().copied().collect()),
        ("rotations", rotations.flat_map(|q| q.to_array()).collect()),
        ("root", root.flat_map(|p| p.to_array()).collect()),
    ]
}

#[test]
fn json_numbers_are_the_motions_to_a_micrometre() {
    let motion = motion(60);
    let value = json(&motion, WITH_ROTATIONS);
    for (array, expected) in arrays(&motion) {
        let written = flat(&value[array]);
        assert_eq!(written.len(), expected.len());
        for (written, expected) in written.into_iter().zip(expected) {
            let error = (written - f64::from(expected)).abs();
            assert!(error <= 0.501e-6, "{array}: {error}");
        }
    }
}

#[test]
fn base64_holds_the_same_numbers_exactly() {
    let motion = motion(30);
    let options = JsonOptions { rotations: true, encoding: Encoding::Base64 };
    let value = json(&motion, options);
    assert_eq!(value["encoding"], "base64");
    assert_eq!(value["positions_source"], "forward_kinematics");
    for (array, expected) in arrays(&motion) {
        let bytes = STANDARD.decode(value[array].as_str().unwrap()).unwrap();
        let (words, rest) = bytes.as_chunks::<4>();
        assert!(rest.is_empty());
        let written: Vec<f32> = words.iter().map(|b| f32::from_le_bytes(*b)).collect();
        assert_eq!(written, expected, "{array}");
    }
}

#[test]
fn motions_that_contradict_themselves_are_refused() {
    type Spoil = fn(&mut GeneratedMotion);
    let spoils: [(&str, Spoil); 5] = [
        ("not finite", |m| m.positions[[1, 2, 0]] = f32::NAN),
        ("2 roots", |m| m.animation.root.truncate(2)),
        ("in frame 1", |m| m.animation.rotations[1].truncate(23)),
        ("unit length", |m| m.animation.rotations[0][3] *= 0.5),
        ("skeleton", |m| m.skeleton.parents[4] = 9),
    ];
    for (expected, spoil) in spoils {
        let mut motion = short(3);
        spoil(&mut motion);
        for format in OutputFormat::ALL {
            let written = format.write(&motion, &WriteOptions::default());
            let error = written.unwrap_err().to_string();
            assert!(error.contains(expected), "{error:?} should say {expected:?}");
        }
    }
}

#[test]
fn equal_motions_are_equal_files_of_no_more_than_was_reserved() {
    let motion = motion(60);
    for format in OutputFormat::ALL {
        for skeleton in TargetSkeleton::ALL {
            let options = WriteOptions { skeleton, ..WriteOptions::default() };
            let file = format.write(&motion, &options).unwrap();
            assert!(file == format.write(&motion.clone(), &options).unwrap(), "{format:?}");
            let most = format.most_bytes(motion.size(), &options);
            assert!(file.len() <= most, "{format:?}: {} of {most} bytes", file.len());
        }
    }
}

#[test]
fn a_skeleton_of_other_joints_is_refused_where_names_matter() {
    let mut motion = short(2);
    motion.skeleton.joints[9] = "tail".into();
    let options = WriteOptions { skeleton: TargetSkeleton::Mixamo, ..WriteOptions::default() };
    for format in OutputFormat::ALL {
        let own = format.write(&motion, &WriteOptions::default());
        let needs_names = [OutputFormat::Vrma, OutputFormat::Vmd, OutputFormat::Npz];
        assert_eq!(own.is_err(), needs_names.contains(&format), "{format:?}");
        let mixamo = format.write(&motion, &options);
        assert_eq!(mixamo.is_err(), format != OutputFormat::Json, "{format:?}");
    }
}

#[test]
fn a_motion_without_frames_is_a_file_without_movement() {
    let motion = short(0);
    for format in OutputFormat::ALL {
        assert!(format.write(&motion, &WriteOptions::default()).is_ok(), "{format:?}");
    }
}

#[test]
fn bvh_header_is_as_programs_expect_it() {
    let text = to_bvh(&short(2), BvhUnit::Centimetre).unwrap();
    let (header, motion) = text.split_at(text.find("Frame Time").unwrap());
    insta::assert_snapshot!(header.replace('\t', "  "));
    let lines: Vec<&str> = motion.lines().collect();
    assert_eq!(lines[0], "Frame Time: 0.01666667");
    let columns: Vec<usize> = lines[1..].iter().map(|l| l.split(' ').count()).collect();
    assert_eq!(columns, [3 + 3 * 24; 2]);
}

#[cfg(feature = "openapi")]
#[test]
fn the_schema_describes_the_json() {
    use bailando_formats::{Codes, Continuation, MotionJson};
    use utoipa::OpenApi;

    #[derive(OpenApi)]
    #[openapi(components(schemas(MotionJson<'_>)))]
    struct Document;

    fn keys(object: &Value) -> std::collections::BTreeSet<&String> {
        object.as_object().unwrap().keys().collect()
    }

    let document = serde_json::to_value(Document::openapi()).unwrap();
    let schemas = &document["components"]["schemas"];
    let mut motion = short(1);
    motion.continuation = Some(Continuation::new("00", Codes::default(), [0.0; 2], 0.0));
    let written = json(&motion, WITH_ROTATIONS);
    assert_eq!(keys(&written), keys(&schemas["Dance"]["properties"]));
    for (key, schema) in [
        ("skeleton", "Skeleton"),
        ("codes", "Codes"),
        ("music", "Music"),
        ("timings_ms", "Timings"),
    ] {
        assert_eq!(keys(&written[key]), keys(&schemas[schema]["properties"]));
    }
}
