//! The same dance in every format comes out the same.

use std::{fs, io::Write};

use bailando::{
    formats::{
        BvhUnit, Codes, GeneratedMotion, PositionsSource, TargetSkeleton, Timings, to_bvh_for,
        to_npz,
    },
    motion::forward,
};

use super::*;
use crate::data::{
    Dataset, JOINTS, OpenOptions,
    check::{CheckOptions, check},
    testing::{animation, clicks},
};

const FRAMES: usize = 300;

/// The swaying figure as a generated motion, and its joints with the feet on the floor.
fn dance() -> (GeneratedMotion, Positions) {
    let skeleton = skeleton(ROOT_HEIGHT);
    let mut animation = animation(JOINTS, FRAMES, 1);
    for pose in &mut animation.rotations {
        // Hands rest in every format.
        pose[22..].fill(glam::Quat::IDENTITY);
    }
    let mut positions = forward(&skeleton, &animation).unwrap();
    let mut lower: Vec<f32> =
        positions.outer_iter().map(|pose| pose[[10, 1]].min(pose[[11, 1]])).collect();
    lower.sort_by(f32::total_cmp);
    let low = lower[FRAMES / 20];
    for mut pose in positions.outer_iter_mut() {
        pose.column_mut(1).mapv_inplace(|height| height + 0.015 - low);
    }
    let motion = GeneratedMotion {
        model: "test".into(),
        seed: 1,
        skeleton,
        animation,
        positions: positions.clone(),
        positions_source: PositionsSource::ForwardKinematics,
        codes: Codes::default(),
        style: None,
        music: None,
        timings: Timings::default(),
        warnings: Vec::new(),
        song_start_s: 0.0,
        continuation: None,
    };
    (motion, positions)
}

fn options(inputs: &[PathBuf], out: &Path) -> ConvertOptions {
    ConvertOptions { inputs: inputs.to_vec(), out: out.to_owned(), audio: None, test: Vec::new() }
}

/// Converts one file and returns what became of its motion.
fn converted(folder: &Path, name: &str, bytes: &[u8]) -> Positions {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    let out = folder.join(format!("{name}.data"));
    let done = convert(&options(&[path], &out)).unwrap();
    assert!(done.motions == 1 && done.refused.is_empty(), "{done:?}");
    let data = Dataset::open(&out, &OpenOptions::default()).unwrap();
    let motion = data.training().unwrap().recordings()[0].motion(&data.skeleton).unwrap();
    motion.positions().clone()
}

/// Largest distance of two joints, metres, with the paths laid on each other.
fn farthest(a: &Positions, b: &Positions) -> f32 {
    assert_eq!(a.dim(), b.dim());
    let way = [0, 1, 2].map(|axis| a[[0, 0, axis]] - b[[0, 0, axis]]);
    assert!(way[1].abs() < 0.01, "the floor is off by {} m", way[1]);
    let pairs = a.indexed_iter().zip(b);
    pairs.map(|(((_, _, axis), a), b)| (a - b - way[axis]).abs()).fold(0.0, f32::max)
}

#[test]
fn amass_comes_out_as_it_went_in() {
    let folder = tempfile::tempdir().unwrap();
    let (motion, expected) = dance();
    let found = converted(folder.path(), "a.npz", &to_npz(&motion).unwrap());
    assert!(farthest(&found, &expected) < 2e-3, "{}", farthest(&found, &expected));
}

#[test]
fn compressed_archives_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let (motion, expected) = dance();
    let plain = to_npz(&motion).unwrap();
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(plain)).unwrap();
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let deflated = zip::write::SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated);
    for place in 0..archive.len() {
        let mut entry = archive.by_index(place).unwrap();
        let name = entry.name().unwrap().into_owned();
        writer.start_file(name, deflated).unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).unwrap();
        writer.write_all(&bytes).unwrap();
    }
    let packed = writer.finish().unwrap().into_inner();
    let found = converted(folder.path(), "packed.npz", &packed);
    assert!(farthest(&found, &expected) < 2e-3);
}

#[test]
fn bvh_of_every_rig_keeps_the_bones_directions() {
    let folder = tempfile::tempdir().unwrap();
    let (motion, expected) = dance();
    for target in TargetSkeleton::ALL {
        for unit in [BvhUnit::Metre, BvhUnit::Centimetre] {
            let text = to_bvh_for(&motion, unit, target).unwrap();
            let name = format!("{}_{unit:?}.bvh", target.name());
            let found = converted(folder.path(), &name, text.as_bytes());
            let far = farthest(&found, &expected);
            assert!(far < 0.02, "{name}: {far}");
        }
    }
}

/// Our BVH with the names of another rig and without some of its joints.
fn renamed(text: &str, names: &[(&str, &str)]) -> String {
    let mut text = text.to_owned();
    for (from, to) in names {
        let joint = |name: &str| format!("JOINT {name}\n");
        text = text.replace(&joint(from), &joint(to));
    }
    text
}

#[test]
fn joints_that_a_rig_lacks_lie_between_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let (motion, expected) = dance();
    let text = to_bvh_for(&motion, BvhUnit::Metre, TargetSkeleton::Mixamo).unwrap();
    let names = ["Spine1", "LeftShoulder", "RightHandMiddle1", "Head"];
    let unknown: Vec<(String, String)> =
        names.iter().map(|name| (format!("mixamorig{name}"), format!("twist_{name}"))).collect();
    let pairs: Vec<(&str, &str)> = unknown.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    let found = converted(folder.path(), "few.bvh", renamed(&text, &pairs).as_bytes());
    // Legs are as before, the trunk is nearly.
    for joint in 0..JOINTS {
        let far = (0..FRAMES)
            .flat_map(|frame| [0, 1, 2].map(|axis| (frame, axis)))
            .map(|(frame, axis)| {
                let of = |p: &Positions| p[[frame, joint, axis]] - p[[frame, 0, axis]];
                (of(&found) - of(&expected)).abs()
            })
            .fold(0.0, f32::max);
        let allowed = if [1, 2, 4, 5, 7, 8, 10, 11].contains(&joint) { 0.03 } else { 0.15 };
        assert!(far < allowed, "joint {joint}: {far}");
    }
    let text = renamed(&text, &[("mixamorigLeftLeg", "Limb")]);
    let path = folder.path().join("odd.bvh");
    fs::write(&path, text).unwrap();
    let done = convert(&options(&[path], &folder.path().join("odd"))).unwrap();
    let refused = done.refused[0].to_string();
    assert!(refused.contains("odd.bvh: its joints are of no rig that is known"), "{refused}");
    assert!(refused.contains("no l_knee among mixamorigHips"), "{refused}");
    assert!(!folder.path().join("odd/index.json").exists());
}

#[test]
fn a_folder_of_all_formats_becomes_usable_data() {
    let folder = tempfile::tempdir().unwrap();
    let captures = folder.path().join("captures/day1");
    fs::create_dir_all(&captures).unwrap();
    let (motion, _) = dance();
    let bvh = to_bvh_for(&motion, BvhUnit::Centimetre, TargetSkeleton::Smpl).unwrap();
    fs::write(captures.join("walk.bvh"), bvh).unwrap();
    fs::write(captures.join("turn.npz"), to_npz(&motion).unwrap()).unwrap();
    fs::write(captures.join("shape.npz"), b"PK\x05\x06no archive").unwrap();
    fs::write(captures.join("notes.txt"), "").unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/train");
    fs::copy(fixtures.join("aist_protocol4.pkl"), captures.join("short.pkl")).unwrap();
    let songs = folder.path().join("songs");
    fs::create_dir(&songs).unwrap();
    fs::write(songs.join("walk.wav"), clicks(5.0, 0.1, Some(0.5))).unwrap();

    let out = folder.path().join("data");
    let mut options = options(&[folder.path().join("captures")], &out);
    options.audio = Some(songs);
    options.test = vec!["turn".into()];
    let done = convert(&options).unwrap();
    assert_eq!((done.motions, done.songs, done.refused.len()), (3, 1, 1));
    assert!(done.refused[0].to_string().contains("shape.npz: this is no NumPy archive"));
    let report = check(&out, &CheckOptions::default()).unwrap();
    assert!(report.is_usable(), "{report}");
    let pieces: Vec<_> = report.splits.iter().map(|split| (split.pieces, split.songs)).collect();
    assert_eq!(pieces, [(2, 1), (1, 0)]);

    let again = convert(&options).unwrap_err().to_string();
    assert!(again.contains("a data folder is there already"), "{again}");
    options.out = folder.path().join("other");
    options.test = vec!["jump".into()];
    assert!(convert(&options).unwrap_err().to_string().contains("--test jump"));
    options.inputs = vec![captures.join("notes.txt")];
    assert!(convert(&options).unwrap_err().to_string().contains("notes.txt: no motion here"));
}

#[test]
fn broken_captures_are_refused_with_file_and_frame() {
    let folder = tempfile::tempdir().unwrap();
    let (mut motion, _) = dance();
    let text = to_bvh_for(&motion, BvhUnit::Metre, TargetSkeleton::Smpl).unwrap();
    let (head, frames) = text.rsplit_once("Frame Time: ").unwrap();
    let mut lines: Vec<&str> = frames.lines().collect();
    let nan = format!("nan{}", lines[18].trim_start_matches(|c: char| c != ' '));
    lines[18] = &nan;
    let broken = format!("{head}Frame Time: {}\n", lines.join("\n"));
    let no_rate = format!("{head}Frame Time: 0\n{}", frames.split_once('\n').unwrap().1);
    for (frame, root) in motion.animation.root.iter_mut().enumerate() {
        root.y += 0.1 * (frame as f32 / 9.0).sin();
        *root *= 93.0;
    }
    for (name, bytes, words) in [
        ("nan.bvh", broken.into_bytes(), "nan.bvh: frame 17 holds a value that is no number"),
        ("rate.bvh", no_rate.into_bytes(), "rate.bvh: it has inf frames a second"),
        ("cm.npz", to_npz(&motion).unwrap(), "cm.npz: the root moves by"),
        ("text.bvh", b"once upon a time".to_vec(), "text.bvh: expected HIERARCHY"),
        ("hostile.pkl", b"cposix\nsystem\n.".to_vec(), "posix.system"),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        let done = convert(&options(&[path], &folder.path().join("out"))).unwrap();
        let refused = done.refused[0].to_string();
        assert!(done.motions == 0 && refused.contains(words), "{refused}");
    }
}
