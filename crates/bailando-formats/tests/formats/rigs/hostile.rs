//! Files of strangers: refused in words.

use bailando_formats::{Character, FormatError, RigLimits, RigMapping};
use bailando_testkit::rigs;
use glam::{DQuat, DVec3};

use super::chunks;
use crate::short;

fn refused(bytes: Vec<u8>) -> String {
    let limits = RigLimits { bones: 1000, ..RigLimits::default() };
    match Character::read(bytes, &RigMapping::default(), &limits) {
        Ok(_) => panic!("it was accepted"),
        Err(error) => {
            assert!(matches!(error, FormatError::Rig(_)), "{error:?}");
            error.to_string()
        }
    }
}

#[test]
fn hostile_glb_files_are_refused_in_words() {
    let of = |json: &str| rigs::container(json, b"");
    let node = "{\"translation\":[1e300,1e300,0],\"rotation\":[0,0,0,1]";
    let chain: Vec<String> =
        (1..=900).map(|next| format!("{node},\"children\":[{next}]}}")).collect();
    let asset = "\"asset\":{\"version\":\"2.0\"}";
    let with = |nodes: &str| of(&format!("{{{asset},\"nodes\":[{nodes}]}}"));
    let good = rigs::mixamo(1.7).bytes;
    let cut = |end: usize| good[..end].to_vec();
    let mut longer = good.clone();
    longer[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
    let vrm = |extension: &str, bones: &str| {
        let humanoid = format!("{{\"humanoid\":{{\"humanBones\":{bones}}}}}");
        format!("{{{asset},\"nodes\":[{{}}],\"extensions\":{{\"{extension}\":{humanoid}}}}}")
    };
    let each = |bone: fn(usize) -> String| (0..300).map(bone).collect::<Vec<_>>().join(",");
    let named = format!("{{{}}}", each(|number| format!("\"b{number}\":{{\"node\":0}}")));
    let numbered = format!("[{}]", each(|_| "{\"bone\":\"hips\",\"node\":0}".into()));
    let mut deep = "[".repeat(100_000);
    deep.push_str(&"]".repeat(100_000));
    for (bytes, expected) in [
        (b"RIFFsomething".to_vec(), "neither BVH nor GLB"),
        (cut(8), "its header says"),
        (cut(200), "its header says"),
        (longer, "longer than the file"),
        (of("{}"), "missing field `asset`"),
        (of(&format!("{{{asset},\"nodes\":{deep}}}")), "`nodes` of its JSON"),
        (with(&format!("{}{{}}", "{},".repeat(1000))), "more than 1000 bones"),
        (with("{\"children\":[1]},{\"children\":[0]}"), "in a circle"),
        (with("{\"children\":[0]}"), "in a circle"),
        (with("{\"children\":[2]},{\"children\":[2]},{}"), "hangs on two nodes"),
        (with("{\"children\":[7]}"), "a child 7 that is none"),
        (with("{\"translation\":[1e999,0,0]}"), "number out of range"),
        (with("{\"rotation\":[0,0,0,0]}"), "no rotation"),
        (with("{\"matrix\":[0,0,0]}"), "no 16 numbers"),
        (with("{\"matrix\":[0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0]}"), "no rotation"),
        (with(&format!("{},{{}}", chain.join(","))), "no humanoid is found"),
        (with(""), "no humanoid is found"),
        (with(&format!("{{\"name\":\"{}\"}}", "n".repeat(1001))), "is a name of 1001 bytes"),
        (of(&vrm("VRMC_vrm", &named)), "more than 256 humanoid bones"),
        (of(&vrm("VRM", &numbered)), "more than 256 elements"),
    ] {
        let error = refused(bytes);
        assert!(error.contains(expected) && error.len() < 700, "{expected:?}: {error}");
    }
    let many = rigs::Glb { extra: vec!["x".into(); 990], ..rigs::Glb::default() };
    let armature = Some((1.0, DQuat::IDENTITY));
    let many = rigs::Glb { armature, ..many };
    let error = refused(rigs::glb(&rigs::mixamo(1.7).body, &many));
    assert!(error.contains("more than 1000 bones"), "{error}");
    let large = RigLimits { bytes: 100, ..RigLimits::default() };
    let error = Character::read(good, &RigMapping::default(), &large).unwrap_err();
    assert!(error.to_string().contains("100 bytes"), "{error}");
}

#[test]
fn hostile_bvh_files_are_refused_in_words() {
    let of = |text: &str| format!("HIERARCHY\n{text}").into_bytes();
    let open = "ROOT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n";
    let deep: String = (0..2000).map(|k| format!("JOINT j{k}\n{{\nOFFSET 0 1 0\n")).collect();
    for (bytes, expected) in [
        (of(""), "without MOTION"),
        (of("MOTION\n"), "does not end"),
        (of(&format!("{open}MOTION\n")), "does not end"),
        (of(&format!("{open}{deep}")), "more than 1000 bones"),
        (of(&format!("{open}}}\n}}\n")), "closes nothing"),
        (of("{\n"), "opens nothing"),
        (of("ROOT a\n{\n}\nROOT b\n{\n"), "several roots"),
        (of("ROOT a\n{\nOFFSET 0 nan 0\n"), "the OFFSET of `a` is `0 nan 0`"),
        (of("ROOT a\n{\nOFFSET 0 0\n"), "not three numbers"),
        (of("ROOT a\n{\nOFFSET 0 1e308 0\n"), "of at most 1000000"),
        (of("ROOT a\n{\nCHANNELS 3 Xrotation Xrotation Yrotation\n"), "the CHANNELS of `a`"),
        (of("ROOT a\n{\nCHANNELS 99999999999999999999 Xrotation\n"), "the CHANNELS of `a`"),
        (of("OFFSET 0 0 0\n"), "outside of a joint"),
        (of("ROOT a\n{\nSURPRISE\n"), "the line `SURPRISE`"),
        (of(&format!("{open}}}\nMOTION\n")), "no humanoid is found among its 1 bones"),
        (of(&format!("ROOT {}\n{{\n", "r".repeat(1001))), "is a name of 1001 bytes"),
        (of(&" ".repeat(70_000)), "a line of 70000 bytes"),
    ] {
        let error = refused(bytes);
        assert!(error.contains(expected) && error.len() < 700, "{expected:?}: {error}");
    }
    // A humanoid that cannot travel, or cannot turn.
    let text = String::from_utf8(rigs::bvh_of_60_joints().bytes).unwrap();
    let still = text.replace("6 Xposition Yposition Zposition", "3");
    assert!(refused(still.into_bytes()).contains("position channels"));
    let stiff = text.replace("Zrotation Xrotation Yrotation", "Zrotation").replace("S 6", "S 4");
    let stiff =
        stiff.replace("4 Xposition Yposition Zposition X", "6 Xposition Yposition Zposition X");
    let stiff =
        stiff.replace("4 Xposition Yposition Zposition Y", "6 Xposition Yposition Zposition Y");
    assert!(refused(stiff.into_bytes()).contains("three channels of rotation"));
}

#[test]
fn a_figure_that_cannot_stand_is_refused() {
    let mut rig = rigs::mixamo(1.7);
    for bone in &mut rig.body.bones {
        bone.place = DVec3::ZERO;
    }
    let bytes = rigs::glb(&rig.body, &rigs::Glb::default());
    let character = Character::read(bytes, &RigMapping::default(), &RigLimits::default()).unwrap();
    let error = character.dance(&short(4), true).unwrap_err().to_string();
    assert!(error.contains("thigh and shank") && error.contains("rig_mapping"), "{error}");

    let squashed = rigs::mixamo(1.7).bytes;
    let (json, binary) = chunks(&squashed);
    let json = json.replace("\"scale\":[0.01,0.01,0.01]", "\"scale\":[0.01,0.02,0.01]");
    let error = refused(rigs::container(&json, binary));
    assert!(error.contains("differs between axes"), "{error}");
}
