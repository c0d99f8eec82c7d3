//! AIST++ motions: SMPL axis-angle rotations to positions by forward kinematics on our own rest
//! offsets, so that no file of the SMPL body model is needed (DESIGN, "Training data folder").

use std::path::Path;

use bailando::motion::{Animation, Positions, Skeleton, forward};
use glam::{Quat, Vec3};

use super::{DataError, FPS, JOINTS, files};
use crate::checkpoint::pickle::{NumpyArray, Object, Pickled, interpret_arrays};

/// An hour of motion in float64 has 130 MB; the longest motion of AIST++ has 2 MB.
const MAX_BYTES: u64 = 128 << 20;

pub(super) fn positions(path: &Path, skeleton: &Skeleton) -> Result<Positions, DataError> {
    let bytes = files::read_at_most(path, MAX_BYTES)?;
    from_bytes(path, &bytes, skeleton)
}

/// `path` is what errors call the pickle.
fn from_bytes(path: &Path, bytes: &[u8], skeleton: &Skeleton) -> Result<Positions, DataError> {
    let pickled = interpret_arrays(bytes)
        .map_err(|problem| DataError::Pickle { path: path.to_owned(), problem })?;
    let animation =
        animation(&pickled).map_err(|what| DataError::Shape { path: path.to_owned(), what })?;
    forward(skeleton, &animation)
        .map_err(|source| DataError::Motion { path: path.to_owned(), source })
}

fn animation(pickled: &Pickled) -> Result<Animation, String> {
    let poses = array(pickled, "smpl_poses")?;
    let trans = array(pickled, "smpl_trans")?;
    let (frames, columns) = match *poses.shape.as_slice() {
        [frames, JOINTS, 3] => (frames, 3 * JOINTS),
        [frames, columns] => (frames, columns),
        _ => (0, 0),
    };
    if columns != 3 * JOINTS || trans.shape != [frames, 3] {
        return Err(format!(
            "smpl_poses has shape {:?} and smpl_trans {:?}, expected [frames, 72] and [frames, 3]",
            poses.shape, trans.shape
        ));
    }
    let scale = scaling(pickled)?;
    let vectors = |array: &NumpyArray| -> Result<Vec<Vec3>, String> {
        let values = array.values()?;
        let vectors = values.chunks_exact(3).filter_map(|chunk| match chunk {
            &[x, y, z] => Some(Vec3::new(x as f32, y as f32, z as f32)),
            _ => None,
        });
        Ok(vectors.collect())
    };
    let turns = vectors(&poses)?;
    Ok(Animation {
        fps: FPS as u32,
        root: vectors(&trans)?.iter().map(|&root| root / scale).collect(),
        rotations: turns
            .chunks_exact(JOINTS)
            .map(|pose| pose.iter().map(|&turn| Quat::from_scaled_axis(turn)).collect())
            .collect(),
    })
}

/// `smpl_scaling`: an array of one value, or a number.
fn scaling(pickled: &Pickled) -> Result<f32, String> {
    let arena = &pickled.arena;
    let found = arena.lookup(pickled.root, "smpl_scaling");
    let value = match found.and_then(|id| arena.get(id)) {
        Some(Object::Float(value)) => *value,
        Some(Object::Int(value)) => *value as f64,
        Some(Object::Array(array)) => match array.values()?.as_slice() {
            &[value] => value,
            _ => {
                return Err(format!("smpl_scaling has shape {:?}, expected [1]", array.shape));
            }
        },
        _ => return Err("smpl_scaling is missing".into()),
    };
    if value.is_finite() && value > 0.0 {
        Ok(value as f32)
    } else {
        Err(format!("smpl_scaling is {value}, expected a number above 0"))
    }
}

fn array(pickled: &Pickled, key: &str) -> Result<NumpyArray, String> {
    let arena = &pickled.arena;
    match arena.lookup(pickled.root, key).and_then(|id| arena.get(id)) {
        Some(Object::Array(array)) => Ok((**array).clone()),
        _ => Err(format!("there is no array `{key}` in it")),
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
