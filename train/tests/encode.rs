//! `encode`: recordings through a model, against the golden codes (ARCHITECTURE section 5).

use crate::common::{codes, fixture, floats};
use crate::testing::TestFolder;
use bailando::model::{ModelDirectory, code_pairs};
use bailando_testkit::model::tiny;
use bailando_train::{
    data::Split,
    encode::{EncodeOptions, encode},
    export::skeleton,
};
use ndarray::{Array2, Array3};

/// The golden motion as joints in world space, its root standing still.
fn golden_positions() -> Array3<f32> {
    let motion = floats(&fixture("motion.npy"));
    Array3::from_shape_fn((motion.nrows(), 24, 3), |(frame, joint, axis)| {
        let root = [0.0, 0.9, 0.0][axis];
        root + if joint == 0 { 0.0 } else { motion[[frame, 3 * joint + axis]] }
    })
}

#[test]
fn recordings_get_the_golden_codes_and_are_decoded_again() {
    let mut data = TestFolder::good(&skeleton(0.93));
    data.motion("three.npy", &golden_positions());
    data.set("three_a", "frames", 240.into());
    let out = tempfile::tempdir().unwrap();
    let options = EncodeOptions {
        model: tiny(),
        data: data.write().to_owned(),
        split: Split::Test,
        out: out.path().to_owned(),
        reconstruct: true,
    };
    assert_eq!(encode(&options).unwrap(), 1);
    let found: Array2<i64> = ndarray_npy::read_npy(out.path().join("three_a.codes.npy")).unwrap();
    for (half, name) in [(0, "enc_up.npy"), (1, "enc_down.npy")] {
        let found: Vec<u32> = found.row(half).iter().map(|&code| code as u32).collect();
        assert_eq!(found, codes(&fixture(name)));
    }
    let positions: Array3<f32> = ndarray_npy::read_npy(out.path().join("three_a.npy")).unwrap();
    let halves = [0, 1].map(|half| found.row(half).iter().map(|&code| code as u32).collect());
    let [upper, lower]: [Vec<u32>; 2] = halves;
    let mut decoder = ModelDirectory::open(&tiny()).unwrap().decoder(1).unwrap();
    let decoded = decoder.decode(&code_pairs(&upper, &lower).unwrap());
    let decoded = decoded.unwrap();
    assert_eq!(positions.dim(), (240, 24, 3));
    for axis in 0..3 {
        let start = [0.0, 0.9, 0.0][axis];
        assert_eq!(positions[[0, 0, axis]], start);
        let relative = positions[[7, 5, axis]] - positions[[7, 0, axis]];
        assert!((relative - decoded[[7, 15 + axis]]).abs() < 1e-5);
        let step = positions[[8, 0, axis]] - positions[[7, 0, axis]];
        assert!((step - decoded[[7, axis]]).abs() < 1e-5);
    }
    // The other split has two recordings, one of them with two songs.
    let both = EncodeOptions { split: Split::Train, reconstruct: false, ..options };
    assert_eq!(encode(&both).unwrap(), 2);
    assert!(out.path().join("one_a.codes.npy").is_file());
    assert!(!out.path().join("one_a.npy").exists());
}
