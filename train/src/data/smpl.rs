//! AIST++ motions: SMPL axis-angle rotations to positions by forward kinematics on our own rest
//! offsets, so that no file of the SMPL body model is needed (DESIGN, "Training data folder").

use std::path::Path;

use bailando::motion::{Animation, Positions, Skeleton, forward};

use super::{DataError, body::BodyPoses, files};
use crate::checkpoint::pickle::{Object, Pickled, interpret_arrays};

/// Keys of AIST++, then of other writers.
const POSES: [&str; 3] = ["smpl_poses", "poses", "pose"];
const PATHS: [&str; 3] = ["smpl_trans", "trans", "transl"];
const SCALINGS: [&str; 2] = ["smpl_scaling", "scaling"];
const RATES: [&str; 4] = ["mocap_framerate", "mocap_frame_rate", "fps", "frame_rate"];

/// An hour of motion in float64 has 130 MB; the longest motion of AIST++ has 2 MB.
const MAX_BYTES: u64 = 128 << 20;

pub(super) fn positions(path: &Path, skeleton: &Skeleton) -> Result<Positions, DataError> {
    let bytes = files::read_at_most(path, MAX_BYTES)?;
    from_bytes(path, &bytes, skeleton)
}

/// `path` is what errors call the pickle.
fn from_bytes(path: &Path, bytes: &[u8], skeleton: &Skeleton) -> Result<Positions, DataError> {
    let (animation, _) = parse(path, bytes)?;
    forward(skeleton, &animation)
        .map_err(|source| DataError::Motion { path: path.to_owned(), source })
}

/// Reads the rotations of a pickle, and its frames a second, where it says them.
pub(super) fn rotations(path: &Path) -> Result<(Animation, Option<f64>), DataError> {
    parse(path, &files::read_at_most(path, MAX_BYTES)?)
}

fn parse(path: &Path, bytes: &[u8]) -> Result<(Animation, Option<f64>), DataError> {
    let pickled = interpret_arrays(bytes)
        .map_err(|problem| DataError::Pickle { path: path.to_owned(), problem })?;
    let file = File(&pickled);
    let read = || -> Result<_, String> {
        let body = BodyPoses {
            poses: file.array(&POSES)?,
            path: file.array(&PATHS)?,
            scaling: file.number(&SCALINGS)?.map(|value| value as f32),
        };
        Ok((body.animation()?, file.number(&RATES)?))
    };
    read().map_err(|what| DataError::Shape { path: path.to_owned(), what })
}

/// A pickled dictionary, whose keys depend on who wrote it.
struct File<'a>(&'a Pickled);

impl File<'_> {
    fn get(&self, keys: &[&str]) -> Option<(&Object, String)> {
        let arena = &self.0.arena;
        keys.iter().find_map(|key| {
            let object = arena.get(arena.lookup(self.0.root, key)?)?;
            Some((object, (*key).to_owned()))
        })
    }

    fn array(&self, keys: &[&str]) -> Result<(Vec<usize>, Vec<f32>), String> {
        match self.get(keys) {
            Some((Object::Array(array), _)) => {
                let values = array.values()?.into_iter().map(|value| value as f32);
                Ok((array.shape.clone(), values.collect()))
            }
            _ if self.get(&["keypoints3d", "keypoints3d_optim"]).is_some() => {
                Err("it holds keypoints3d, joints of COCO: this is AIST++'s folder keypoints3d, \
                     motions are in its folder motions"
                    .into())
            }
            _ => Err(format!("there is no array `{}` in it", keys.join("` or `"))),
        }
    }

    /// A number, or an array of one.
    fn number(&self, keys: &[&str]) -> Result<Option<f64>, String> {
        match self.get(keys) {
            None => Ok(None),
            Some((Object::Float(value), _)) => Ok(Some(*value)),
            Some((Object::Int(value), _)) => Ok(Some(*value as f64)),
            Some((Object::Array(array), key)) => match array.values()?.as_slice() {
                &[value] => Ok(Some(value)),
                _ => Err(format!("{key} has shape {:?}, expected [1]", array.shape)),
            },
            Some((_, key)) => Err(format!("{key} is no number")),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::{data::npy, export::skeleton};

    fn fixture(name: &str) -> PathBuf {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/train");
        folder.join(name)
    }

    #[test]
    fn every_protocol_gives_the_joints_that_numpy_computed() {
        let expected = npy::positions(&fixture("aist_joints.npy")).unwrap();
        for name in [
            "aist_protocol2.pkl",
            "aist_protocol3.pkl",
            "aist_protocol4.pkl",
            "aist_protocol5.pkl",
            "aist_float64.pkl",
            "aist_numpy1.pkl",
        ] {
            let found = positions(&fixture(name), &skeleton(0.93)).unwrap();
            assert_eq!(found.dim(), (12, 24, 3), "{name}");
            let worst = (&found - &expected).mapv(f32::abs);
            let worst = worst.iter().copied().fold(0.0, f32::max);
            assert!(worst < 2e-5, "{name}: {worst:e}");
        }
    }

    #[test]
    fn a_pickle_that_asks_for_code_is_refused() {
        let refused = positions(&fixture("hostile.pkl"), &skeleton(0.93)).unwrap_err();
        let refused = refused.to_string();
        assert!(
            refused.ends_with(
                "asks for `posix.system`, which an array file has no use for; nothing was run"
            ),
            "{refused}"
        );
    }

    #[test]
    fn damaged_pickles_are_errors_and_never_panic() {
        let whole = std::fs::read(fixture("aist_protocol4.pkl")).unwrap();
        let read = |bytes: &[u8]| from_bytes(Path::new("damaged.pkl"), bytes, &skeleton(0.93));
        for length in (0..whole.len()).step_by(97) {
            assert!(read(&whole[..length]).is_err(), "{length} bytes");
        }
        // Every byte in front of the first values, and some of the values.
        for position in (0..300).chain((300..whole.len()).step_by(401)) {
            for mask in [0x01, 0x80, 0xff] {
                let mut changed = whole.clone();
                changed[position] ^= mask;
                let _ = read(&changed);
            }
        }
        let missing = read(b"\x80\x04}.").unwrap_err().to_string();
        assert!(missing.contains("no array `smpl_poses`"), "{missing}");
    }
}
