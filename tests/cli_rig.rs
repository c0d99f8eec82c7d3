//! A character of one's own on the command line.

use std::fs;

use bailando_testkit::rigs;

use crate::cli::{SONG, fail, folder, json, path, succeed};

#[test]
fn a_character_dances_and_comes_back_as_its_own_file() {
    let folder = folder();
    let [hero, avatar, mapping, dance] =
        ["hero.glb", "avatar.vrm", "mapping.json", "dance.VRM"].map(|name| path(&folder, name));
    fs::write(&hero, rigs::unreal(1.9).bytes).expect("a file");
    fs::write(&avatar, rigs::vrm0().bytes).expect("a file");

    let told = succeed(&format!("generate --rig {hero} --print-mapping"));
    fs::write(&mapping, &told).expect("a file");
    let told = json(&mapping);
    assert_eq!((&told["found_by"], &told["bones"]["hips"]), (&"names".into(), &"pelvis".into()));
    assert_eq!(told["bones"]["spine"].as_array().map(Vec::len), Some(5));

    let song = format!("{SONG} --seed 7 --duration-s 2");
    succeed(&format!("generate {song} --rig {avatar} -o {dance}"));
    let file = fs::read(&dance).expect("a dance");
    assert!(file.starts_with(b"glTF") && file.len() > rigs::vrm0().bytes.len());
    let out = path(&folder, "out");
    succeed(&format!("generate {song} --rig {hero} --rig-mapping {mapping} --out-dir {out}"));
    assert!(fs::metadata(format!("{out}/demo.glb")).is_ok());

    for wrong in [
        format!("generate {song} --rig {avatar} -o {folder}/dance.glb", folder = out),
        format!("generate {song} --rig {hero} --skeleton vrm -o {out}/dance.glb"),
        format!("generate {song} --rig {hero} --format json -o {out}/dance.glb"),
        format!("generate {song} --rig-mapping {mapping} -o {out}/dance.glb"),
        format!("generate {song} --print-mapping --rig {hero}"),
    ] {
        let (code, message) = fail(&wrong);
        assert_eq!(code, Some(2), "{wrong}: {message}");
    }
    fs::write(&mapping, "{\"bones\":{\"hips\":\"tail\"}}").expect("a file");
    for (wrong, expected) in [
        (format!("generate {song} --rig Cargo.toml -o {out}/dance.glb"), "neither BVH nor GLB"),
        (
            format!("generate {song} --rig {hero} --rig-mapping {mapping} -o {out}/dance.glb"),
            "the mapping names `tail`",
        ),
        (
            format!("generate {song} --rig {hero} --rig-mapping {hero} -o {out}/dance.glb"),
            "no mapping of bones",
        ),
    ] {
        let (code, message) = fail(&wrong);
        assert_eq!(code, Some(1), "{wrong}: {message}");
        assert!(message.contains(expected), "{message}");
        assert_eq!(message.trim_end().lines().count(), 1, "one line: {message}");
    }
}
