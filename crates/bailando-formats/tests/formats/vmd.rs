//! VMD read back by a parser of this test.

use std::collections::BTreeMap;

use bailando_formats::to_vmd;
use bailando_motion::{forward, resample};
use glam::{DQuat, DVec3};

use crate::motion;

/// Bytes of a key of a bone.
const KEY: usize = 111;
/// Direction of the left arm in the rest pose of customary models: 35 degrees below the horizontal.
const LEFT_ARM: DVec3 = DVec3::new(0.819_152_044, -0.573_576_436, 0.0);

/// Names in Shift-JIS of the bones that lead to the left forearm and the right shin.
const ARM: [&[u8]; 6] = [
    b"\x83\x5a\x83\x93\x83\x5e\x81\x5b",
    b"\x8f\xe3\x94\xbc\x90\x67",
    b"\x8f\xe3\x94\xbc\x90\x67\x32",
    b"\x8d\xb6\x8c\xa8",
    b"\x8d\xb6\x98\x72",
    b"\x8d\xb6\x82\xd0\x82\xb6",
];
const LEG: [&[u8]; 3] = [ARM[0], b"\x89\x45\x91\xab", b"\x89\x45\x82\xd0\x82\xb4"];

struct Key {
    frame: u32,
    place: DVec3,
    turn: DQuat,
}

type Keys = BTreeMap<Vec<u8>, Vec<Key>>;

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

fn text(field: &[u8]) -> Vec<u8> {
    field.iter().copied().take_while(|&byte| byte != 0).collect()
}

/// Reads the keys of all bones, in our right-handed axes.
fn read(file: &[u8]) -> Keys {
    assert_eq!(text(&file[..30]), b"Vocaloid Motion Data 0002");
    let count = word(file, 50) as usize;
    let mut keys = Keys::new();
    for key in file[54..54 + KEY * count].chunks(KEY) {
        let number = |k: usize| f64::from(f32::from_bits(word(key, 19 + 4 * k)));
        assert_eq!(
            key[47..63],
            [20, 20, 20, 20, 20, 20, 20, 20, 107, 107, 107, 107, 107, 107, 107, 107]
        );
        keys.entry(text(&key[..15])).or_default().push(Key {
            frame: word(key, 15),
            place: DVec3::new(number(0), number(1), -number(2)),
            turn: DQuat::from_xyzw(-number(3), -number(4), number(5), number(6)),
        });
    }
    let rest = &file[54 + KEY * count..];
    assert_eq!(rest[..16], [0; 16], "no faces, cameras, lights or shadows");
    let ik = &rest[16..];
    assert_eq!((word(ik, 0), word(ik, 4), ik[8], word(ik, 9)), (1, 0, 1, 4));
    assert_eq!(ik.len(), 13 + 4 * 21);
    assert!(ik[13..].chunks(21).all(|ik| ik[20] == 0), "inverse kinematics is off");
    assert_eq!(text(&ik[13..33]), b"\x8d\xb6\x91\xab\x82\x68\x82\x6a");
    keys
}

fn turn_at(keys: &[Key], frame: u32) -> DQuat {
    let next = keys.partition_point(|key| key.frame < frame);
    let to = &keys[next];
    let from = &keys[next.saturating_sub(1)];
    if to.frame == frame {
        return to.turn;
    }
    from.turn.slerp(to.turn, f64::from(frame - from.frame) / f64::from(to.frame - from.frame))
}

#[test]
fn vmd_turns_limbs_where_forward_kinematics_has_them() {
    for fps in [60, 24] {
        let motion = motion(fps);
        let keys = read(&to_vmd(&motion).unwrap());
        assert_eq!(keys.len(), 19);
        let animation = resample(&motion.animation, 30).unwrap();
        let positions = forward(&motion.skeleton, &animation).unwrap();
        let frames = animation.root.len() as u32;
        for keys in keys.values() {
            assert_eq!((keys[0].frame, keys[keys.len() - 1].frame), (0, frames - 1));
            assert!(keys.windows(2).all(|pair| pair[0].frame < pair[1].frame));
        }
        let joint = |name: &str| motion.skeleton.joints.iter().position(|j| j == name).unwrap();
        let place = |frame: u32, name: &str| {
            let joint = joint(name);
            DVec3::from([0, 1, 2].map(|axis| f64::from(positions[[frame as usize, joint, axis]])))
        };
        for frame in (0..frames).step_by(5) {
            for (chain, rest, from, to) in [
                (ARM.as_slice(), LEFT_ARM, "l_elbow", "l_wrist"),
                (LEG.as_slice(), DVec3::NEG_Y, "r_knee", "r_ankle"),
            ] {
                let turns = chain.iter().map(|&bone| turn_at(&keys[bone], frame));
                let seen = turns.fold(DQuat::IDENTITY, |all, turn| all * turn) * rest;
                let wanted = (place(frame, to) - place(frame, from)).normalize();
                let apart = seen.angle_between(wanted).to_degrees();
                assert!(apart < 0.5, "frame {frame}, {from}: {apart} degrees");
            }
        }
        // 12.5 units a metre, from where the hips rest.
        let centre = &keys[ARM[0]];
        let [a, b] = [&centre[3], &centre[centre.len() - 2]];
        let travelled = (b.place - a.place) / 12.5;
        let wanted = place(b.frame, "pelvis") - place(a.frame, "pelvis");
        assert!(travelled.distance(wanted) < 1e-5, "{travelled} is not {wanted}");
    }
}
