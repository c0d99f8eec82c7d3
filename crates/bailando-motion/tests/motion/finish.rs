//! Finished motions: root motion, floor, frame rates, and motions in pieces.

use bailando_motion::{
    Animation, FRAME_RATES, FinishOptions, Finished, Finisher, MotionError, Positions,
    PositionsSource, STANDING_HEIGHT, floor_correction, integrate_root, lower_foot_heights,
};
use bailando_testkit::motion::{decoded_from, distances, fixture, recordings, skeleton};
use glam::Vec3;
use ndarray::{Array2, Axis};

use crate::{assert_continuous_unit_quaternions, assert_near, posed, swinging};

/// ARCHITECTURE section 5.
const GOLDEN_TOLERANCE: f32 = 2e-5;

/// As decoded.
fn at(fps: u32) -> FinishOptions {
    FinishOptions { fps, clean: false, ..FinishOptions::default() }
}

/// As decoded, with the decoder's own positions.
fn decoders() -> FinishOptions {
    FinishOptions { positions: PositionsSource::Decoder, ..at(60) }
}

fn try_finish(decoded: &Array2<f32>, options: &FinishOptions) -> Result<Finished, MotionError> {
    bailando_motion::finish(decoded.view(), &skeleton(), options)
}

fn finish(decoded: &Array2<f32>, options: &FinishOptions) -> Finished {
    try_finish(decoded, options).unwrap()
}

/// A decoder's output for [`swinging`], with `drift` metres a second added to its root.
fn decoded_swinging(frames: usize, drift: f32) -> Array2<f32> {
    let mut decoded = decoded_from(&posed(&swinging(frames, 60)));
    decoded.column_mut(1).mapv_inplace(|y| y + drift / 60.0);
    decoded
}

/// The decoder's output of the bootstrap model for a whole song.
fn decoded_song() -> Option<Array2<f32>> {
    let path = bailando_testkit::shared("model/bootstrap/demo_decode_hop15.npy")?;
    Some(ndarray_npy::read_npy(path).unwrap())
}

#[test]
fn integrated_root_equals_the_golden_files() {
    let positions = integrate_root(fixture("decode_raw.npy").view(), [0.0; 3]).unwrap();
    let absolute = fixture("joints_abs.npy");
    let relative = fixture("joints_rel.npy");
    assert_eq!(positions.dim(), (480, 24, 3));
    for ((frame, joint, axis), &value) in positions.indexed_iter() {
        let column = 3 * joint + axis;
        assert!((value - absolute[[frame, column]]).abs() <= GOLDEN_TOLERANCE);
        let root = match joint {
            0 => 0.0,
            _ => positions[[frame, 0, axis]],
        };
        assert!((value - root - relative[[frame, column]]).abs() <= GOLDEN_TOLERANCE);
    }
}

#[test]
fn at_the_decoders_rate_the_decoders_poses_come_back() {
    let decoded = decoded_swinging(600, 0.05);
    let done = finish(&decoded, &decoders());
    assert_eq!(done.source, PositionsSource::Decoder);
    assert_eq!(done.positions.dim(), (600, 24, 3));
    for (frame, pose) in done.positions.outer_iter().enumerate() {
        for joint in 1..24 {
            for axis in 0..3 {
                let relative = pose[[joint, axis]] - pose[[0, axis]];
                assert!((relative - decoded[[frame, 3 * joint + axis]]).abs() < 1e-5);
            }
        }
        let root = done.animation.root[frame];
        assert_eq!([root.x, root.z], [pose[[0, 0]], pose[[0, 2]]]);
    }
    assert_near(&done.positions, &posed(&done.animation), 1e-4);
}

#[test]
fn positions_are_those_of_the_rotations() {
    let decoded = decoded_swinging(601, 0.0);
    for (fps, frames) in [(20, 201), (24, 241), (30, 301), (60, 601)] {
        let done = finish(&decoded, &at(fps));
        assert_eq!(done.source, PositionsSource::ForwardKinematics);
        assert_eq!(done.positions.dim(), (frames, 24, 3));
        assert_near(&done.positions, &posed(&done.animation), 1e-5);
    }
    let refused = try_finish(&decoded, &at(25));
    assert_eq!(refused, Err(MotionError::FrameRate { got: 25 }));
    for options in
        [FinishOptions { fps: 30, ..decoders() }, FinishOptions { clean: true, ..decoders() }]
    {
        let refused = try_finish(&decoded, &options);
        assert_eq!(refused, Err(MotionError::DecoderPositions { decoded_fps: 60 }));
    }
}

#[test]
fn without_root_motion_the_dancer_stays_in_place_at_the_same_height() {
    let decoded = decoded_swinging(300, 0.0);
    let travels = finish(&decoded, &decoders());
    let stays = finish(&decoded, &FinishOptions { root_motion: false, ..decoders() });
    for (a, b) in stays.animation.root.iter().zip(&travels.animation.root) {
        assert_eq!(*a, Vec3::Y * b.y);
    }
    assert!(travels.animation.root[299].x > 2.0);
    assert_eq!(stays.animation.rotations, travels.animation.rotations);
    assert_near(&stays.positions, &posed(&stays.animation), 1e-4);
}

#[test]
fn an_empty_or_single_frame_is_no_special_case() {
    for frames in [0, 1] {
        for fps in FRAME_RATES {
            for clean in [false, true] {
                let options = FinishOptions { clean, ..at(fps) };
                let done = finish(&Array2::zeros((frames, 72)), &options);
                assert_eq!(done.positions.dim(), (frames, 24, 3));
            }
        }
    }
    let other_skeleton = try_finish(&Array2::zeros((4, 69)), &at(60));
    assert!(matches!(other_skeleton, Err(MotionError::Shape { .. })));
}

#[test]
fn decoded_poses_with_bones_of_any_length_become_rotations() {
    // An untrained model's poses: nothing about them is human.
    let decoded = fixture("decode_raw.npy");
    for fps in FRAME_RATES {
        let done = finish(&decoded, &at(fps));
        let frames = (480 * fps as usize).div_ceil(60);
        assert_eq!(done.positions.dim(), (frames, 24, 3));
        assert_stands(&done.positions, fps, 0.05, &format!("golden at {fps} fps"));
        assert_continuous_unit_quaternions(&done.animation);
    }
}

#[test]
fn decoded_motion_lies_close_to_the_skeleton() {
    let Some(decoded) = decoded_song() else {
        return;
    };
    let done = finish(&decoded, &decoders());
    let on_skeleton = posed(&done.animation);
    let (mean, largest) = distances(&done.positions, &on_skeleton);
    println!("bootstrap decode: mean {mean:.4} m, largest {largest:.4} m");
    assert!(mean < 0.03, "{mean} m");
    assert_stands(&done.positions, 60, 0.02, "decoder");
    assert_stands(&on_skeleton, 60, 0.05, "skeleton");
}

#[test]
fn drifting_recordings_are_put_back_on_the_floor() {
    let Some(folder) = bailando_testkit::shared("data/salsa") else {
        return;
    };
    type Drift = fn(f32) -> f32;
    let drifts: [(&str, Drift); 4] = [
        ("none", |_| 0.0),
        ("sinking", |s| -0.06 * s),
        ("swaying", |s| 0.25 * (0.45 * s).sin()),
        ("wandering", |s| 0.1 * (0.7 * s).sin() + 0.15 * (0.31 * s).cos() + 0.02 * s),
    ];
    for (index, (path, mut positions)) in recordings(&folder).into_iter().enumerate().step_by(3) {
        let (name, drift) = drifts[index / 3 % drifts.len()];
        for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
            let added = drift(frame as f32 / 60.0);
            pose.column_mut(1).mapv_inplace(|y| y + added);
        }
        let decoded = decoded_from(&positions);
        for fps in [60, 20] {
            let label = format!("{} {name} at {fps} fps", path.display());
            assert_stands(&finish(&decoded, &at(fps)).positions, fps, 0.02, &label);
        }
    }
}

/// The motion of `decoded`, finished in pieces of so many frames.
fn in_pieces(decoded: &Array2<f32>, options: &FinishOptions, piece: usize) -> Finished {
    let mut finisher = Finisher::new(&skeleton(), options).unwrap();
    let pieces = decoded.axis_chunks_iter(Axis(0), piece);
    let mut done: Vec<Finished> = pieces.map(|rows| finisher.push(rows).unwrap()).collect();
    done.push(finisher.end().unwrap());
    let source = done[0].source;
    let parts: Vec<_> = done.iter().map(|part| part.positions.view()).collect();
    let positions = ndarray::concatenate(Axis(0), &parts).unwrap();
    let (roots, rotations): (Vec<_>, Vec<_>) =
        done.into_iter().map(|part| (part.animation.root, part.animation.rotations)).unzip();
    Finished {
        positions,
        animation: Animation {
            fps: options.fps,
            root: roots.concat(),
            rotations: rotations.concat(),
        },
        source,
    }
}

#[test]
fn a_motion_in_pieces_is_the_whole_but_for_millimetres_of_height() {
    let Some(decoded) = decoded_song() else {
        return;
    };
    for fps in FRAME_RATES {
        let whole = finish(&decoded, &at(fps));
        for piece in [64, 191, 1_024] {
            let pieces = in_pieces(&decoded, &at(fps), piece);
            assert_eq!(pieces.source, whole.source);
            assert_eq!(pieces.positions.dim(), whole.positions.dim());
            assert_eq!(pieces.animation.rotations, whole.animation.rotations);
            let label = format!("{fps} fps in pieces of {piece}");
            let mut furthest = 0.0_f32;
            for ((place, a), b) in pieces.positions.indexed_iter().zip(&whole.positions) {
                let difference = (a - b).abs();
                match place.2 {
                    1 => furthest = furthest.max(difference),
                    _ => assert!(difference < 1e-5, "{label}: {place:?} {difference} m"),
                }
            }
            println!("{label}: heights differ by {furthest:.4} m at most");
            assert!(furthest < 0.02, "{label}: {furthest} m");
            assert_stands(&pieces.positions, fps, 0.02, &label);
        }
    }
}

#[test]
fn recordings_that_stand_are_hardly_moved() {
    let Some(folder) = bailando_testkit::shared("data/salsa") else {
        return;
    };
    for (path, positions) in recordings(&folder) {
        let lift = floor_correction(&lower_foot_heights(&positions, &skeleton()), 60);
        // They do lie a little high or low for seconds: the recordings' standing ball is at 3 cm.
        let furthest = lift.iter().map(|l| l.abs()).fold(0.0, f32::max);
        assert!(furthest < 0.07, "{}: {furthest} m", path.display());
        let fastest = lift.windows(2).map(|two| 60.0 * (two[1] - two[0]).abs());
        let fastest = fastest.fold(0.0, f32::max);
        assert!(fastest < 0.1, "{}: {fastest} m/s", path.display());
    }
}

/// Asserts DESIGN.md, "Standing on the floor": in every 5 s the 5th percentile of the lower foot's
/// height.
fn assert_stands(positions: &Positions, fps: u32, tolerance: f32, label: &str) {
    let heights = lower_foot_heights(positions, &skeleton());
    let window = (5 * fps as usize).min(heights.len());
    for (start, seconds) in heights.windows(window).enumerate() {
        let mut sorted = seconds.to_vec();
        sorted.sort_by(f32::total_cmp);
        let low = sorted[(0.05 * (window - 1) as f32).round() as usize];
        let error = (low - STANDING_HEIGHT).abs();
        assert!(error < tolerance, "{label}, from frame {start}: {low} m");
    }
}
