//! The motion chain against golden vectors and recordings.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test says what is wrong by failing"
)]

use bailando_motion::{
    Animation, FRAME_RATES, FinishOptions, Finished, Finisher, InverseKinematics, Positions,
    STANDING_HEIGHT, Skeleton, finish, floor_correction, forward, integrate_root,
    lower_foot_heights,
};
use bailando_testkit::motion::{decoded_from, distances, fixture, recordings, skeleton};
use ndarray::Axis;

/// ARCHITECTURE section 5.
const GOLDEN_TOLERANCE: f32 = 2e-5;

#[test]
fn integrated_root_equals_the_golden_files() {
    let positions = integrate_root(fixture("decode_raw.npy").view(), [0.0; 3]).unwrap();
    let absolute = fixture("joints_abs.npy");
    let relative = fixture("joints_rel.npy");
    assert_eq!(positions.dim(), (480, 24, 3));
    for ((frame, joint, axis), &value) in positions.indexed_iter() {
        let column = 3 * joint + axis;
        assert!((value - absolute[[frame, column]]).abs() <= GOLDEN_TOLERANCE);
        let root = if joint == 0 {
            0.0
        } else {
            positions[[frame, 0, axis]]
        };
        assert!((value - root - relative[[frame, column]]).abs() <= GOLDEN_TOLERANCE);
    }
}

#[test]
fn decoded_poses_with_bones_of_any_length_become_rotations() {
    // An untrained model's poses: nothing about them is human.
    let decoded = fixture("decode_raw.npy");
    for fps in FRAME_RATES {
        let options = FinishOptions {
            fps,
            ..FinishOptions::default()
        };
        let done = finish(decoded.view(), &skeleton(), &options).unwrap();
        assert_eq!(
            done.positions.dim(),
            ((480 * fps as usize).div_ceil(60), 24, 3)
        );
        assert_stands(
            &done.positions,
            &skeleton(),
            fps,
            0.05,
            &format!("golden at {fps} fps"),
        );
        for pair in done.animation.rotations.windows(2) {
            let continuous = pair[0].iter().zip(&pair[1]).all(|(a, b)| a.dot(*b) >= 0.0);
            assert!(continuous);
        }
    }
}

#[test]
fn recordings_are_met_by_their_skeleton() {
    let Some(folder) = bailando_testkit::shared("data/salsa") else {
        return;
    };
    let solver = InverseKinematics::new(&skeleton()).unwrap();
    let (mut sum, mut frames, mut furthest) = (0.0, 0.0, 0.0_f64);
    for (path, positions) in recordings(&folder) {
        let animation = solver.solve(&positions, 60).unwrap();
        let (mean, largest) = distances(&positions, &forward(&skeleton(), &animation).unwrap());
        assert!(largest < 5e-4, "{}: {largest} m", path.display());
        sum += mean * positions.dim().0 as f64;
        frames += positions.dim().0 as f64;
        furthest = furthest.max(largest);
    }
    println!(
        "recordings: {frames} frames, mean {:.3e} m, largest {furthest:.3e} m",
        sum / frames
    );
}

#[test]
fn decoded_motion_lies_close_to_the_skeleton() {
    let Some(path) = bailando_testkit::shared("model/bootstrap/demo_decode_hop15.npy") else {
        return;
    };
    let decoded: ndarray::Array2<f32> = ndarray_npy::read_npy(path).unwrap();
    let done = finish(decoded.view(), &skeleton(), &FinishOptions::default()).unwrap();
    let on_skeleton = forward(&skeleton(), &done.animation).unwrap();
    let (mean, largest) = distances(&done.positions, &on_skeleton);
    println!("bootstrap decode: mean {mean:.4} m, largest {largest:.4} m");
    assert!(mean < 0.03, "{mean} m");
    assert_stands(&done.positions, &skeleton(), 60, 0.02, "decoder");
    assert_stands(&on_skeleton, &skeleton(), 60, 0.05, "skeleton");
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
        ("wandering", |s| {
            0.1 * (0.7 * s).sin() + 0.15 * (0.31 * s).cos() + 0.02 * s
        }),
    ];
    for (index, (path, mut positions)) in recordings(&folder).into_iter().enumerate().step_by(3) {
        let (name, drift) = drifts[index / 3 % drifts.len()];
        for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
            let added = drift(frame as f32 / 60.0);
            pose.column_mut(1).mapv_inplace(|y| y + added);
        }
        let decoded = decoded_from(&positions);
        for fps in [60, 20] {
            let options = FinishOptions {
                fps,
                ..FinishOptions::default()
            };
            let done = finish(decoded.view(), &skeleton(), &options).unwrap();
            let label = format!("{} {name} at {fps} fps", path.display());
            assert_stands(&done.positions, &skeleton(), fps, 0.02, &label);
        }
    }
}

/// The dance of `decoded`, finished in pieces of so many frames.
fn in_pieces(decoded: &ndarray::Array2<f32>, options: &FinishOptions, piece: usize) -> Finished {
    let mut finisher = Finisher::new(&skeleton(), options).unwrap();
    let mut done: Vec<Finished> = decoded
        .axis_chunks_iter(Axis(0), piece)
        .map(|rows| finisher.push(rows).unwrap())
        .collect();
    done.push(finisher.end().unwrap());
    let parts: Vec<_> = done
        .iter()
        .filter(|part| !part.positions.is_empty())
        .map(|part| part.positions.view())
        .collect();
    Finished {
        positions: ndarray::concatenate(Axis(0), &parts).unwrap(),
        animation: Animation {
            fps: options.fps,
            root: done
                .iter()
                .flat_map(|part| part.animation.root.clone())
                .collect(),
            rotations: done
                .iter()
                .flat_map(|part| part.animation.rotations.clone())
                .collect(),
        },
        source: done[0].source,
    }
}

#[test]
fn a_motion_in_pieces_is_the_whole_but_for_millimetres_of_height() {
    let Some(path) = bailando_testkit::shared("model/bootstrap/demo_decode_hop15.npy") else {
        return;
    };
    let decoded: ndarray::Array2<f32> = ndarray_npy::read_npy(path).unwrap();
    for fps in FRAME_RATES {
        let options = FinishOptions {
            fps,
            ..FinishOptions::default()
        };
        let whole = finish(decoded.view(), &skeleton(), &options).unwrap();
        for piece in [64, 191, 1_024] {
            let pieces = in_pieces(&decoded, &options, piece);
            assert_eq!(pieces.source, whole.source);
            assert_eq!(pieces.positions.dim(), whole.positions.dim());
            assert_eq!(pieces.animation.rotations, whole.animation.rotations);
            let mut furthest = 0.0_f32;
            for ((place, a), b) in pieces.positions.indexed_iter().zip(&whole.positions) {
                let apart = (a - b).abs();
                match place.2 {
                    1 => furthest = furthest.max(apart),
                    _ => assert!(apart < 1e-5, "{fps} fps, {piece}: {place:?} {apart} m"),
                }
            }
            println!("{fps} fps in pieces of {piece}: heights differ by {furthest:.4} m at most");
            assert!(furthest < 0.02, "{fps} fps, {piece}: {furthest} m");
            let label = format!("{fps} fps in pieces of {piece}");
            assert_stands(&pieces.positions, &skeleton(), fps, 0.02, &label);
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

/// DESIGN.md, "Standing on the floor": in every 5 s the 5th percentile of the lower foot's height.
fn assert_stands(
    positions: &Positions,
    skeleton: &Skeleton,
    fps: u32,
    tolerance: f32,
    label: &str,
) {
    let heights = lower_foot_heights(positions, skeleton);
    let window = (5 * fps as usize).min(heights.len());
    for (start, seconds) in heights.windows(window).enumerate() {
        let mut sorted = seconds.to_vec();
        sorted.sort_by(f32::total_cmp);
        let low = sorted[(0.05 * (window - 1) as f32).round() as usize];
        let error = (low - STANDING_HEIGHT).abs();
        assert!(error < tolerance, "{label}, from frame {start}: {low} m");
    }
}
