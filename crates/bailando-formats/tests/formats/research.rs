//! npz in the layout of AMASS, read back as NumPy arrays.

use std::io::{Cursor, Read};

use bailando_formats::to_npz;
use bailando_motion::forward;
use glam::{DQuat, DVec3};
use ndarray::{Array0, Array1, Array2};
use ndarray_npy::{ReadNpyExt, ReadableElement};
use zip::ZipArchive;

use crate::motion;

type Archive = ZipArchive<Cursor<Vec<u8>>>;

fn array<T: ReadableElement, D: ndarray::Dimension>(
    archive: &mut Archive,
    name: &str,
) -> ndarray::Array<T, D> {
    ndarray::Array::read_npy(archive.by_name(&format!("{name}.npy")).unwrap()).unwrap()
}

#[test]
fn npz_has_the_layout_of_amass_and_our_positions() {
    let motion = motion(60);
    let frames = motion.animation.root.len();
    let mut archive = ZipArchive::new(Cursor::new(to_npz(&motion).unwrap())).unwrap();
    let poses: Array2<f32> = array(&mut archive, "poses");
    let trans: Array2<f32> = array(&mut archive, "trans");
    let rate: Array0<f64> = array(&mut archive, "mocap_framerate");
    let betas: Array1<f32> = array(&mut archive, "betas");
    assert_eq!((poses.dim(), trans.dim()), ((frames, 156), (frames, 3)));
    assert_eq!((rate.into_scalar(), betas), (60.0, Array1::zeros(16)));
    let mut gender = Vec::new();
    archive.by_name("gender.npy").unwrap().read_to_end(&mut gender).unwrap();
    assert!(gender.ends_with(b"n\0\0\0e\0\0\0u\0\0\0t\0\0\0r\0\0\0a\0\0\0l\0\0\0"));
    assert_eq!(gender.len(), 128 + 4 * "neutral".len());

    // Forward kinematics as research code does it, z up.
    let expected = forward(&motion.skeleton, &motion.animation).unwrap();
    for frame in (0..frames).step_by(7) {
        let mut world: Vec<(DVec3, DQuat)> = Vec::new();
        for joint in 0..22 {
            let vector = |k: usize| f64::from(poses[[frame, 3 * joint + k]]);
            let local = DQuat::from_scaled_axis(DVec3::new(vector(0), vector(1), vector(2)));
            let root = [0, 1, 2].map(|axis| f64::from(trans[[frame, axis]]));
            world.push(match motion.skeleton.parent(joint) {
                None => (root.into(), local),
                Some(parent) => {
                    let (place, turn) = world[parent];
                    (place + turn * motion.skeleton.offset(joint).as_dvec3(), turn * local)
                }
            });
            let [x, y, z] = [0, 1, 2].map(|axis| f64::from(expected[[frame, joint, axis]]));
            let apart = world[joint].0.distance(DVec3::new(x, -z, y));
            assert!(apart < 1e-4, "frame {frame}, joint {joint}: {apart} m");
        }
    }
    let fingers = poses.slice_axis(ndarray::Axis(1), (66..).into());
    assert!(fingers.iter().all(|&v| v == 0.0), "hands rest");
}
