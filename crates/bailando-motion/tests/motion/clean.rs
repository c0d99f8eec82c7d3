//! Cleaned motion: feet, limits, hands and beats, on decoded songs and on recordings.

use bailando_motion::{
    FinishOptions, Finished, Finisher, Positions, Skeleton, dance_beats, joint_speed,
};
use bailando_testkit::motion::{decoded_from, fixture, recordings, skeleton};
use glam::{Quat, Vec3};
use ndarray::{Array2, Axis, Slice};

use crate::{assert_continuous_unit_quaternions, posed};

const FEET: [usize; 2] = [10, 11];

fn finish(decoded: &Array2<f32>, clean: bool) -> Finished {
    let options = FinishOptions { clean, ..FinishOptions::default() };
    bailando_motion::finish(decoded.view(), &skeleton(), &options).unwrap()
}

/// Decoded dances: a whole song of the bootstrap model, and recordings of salsa.
fn dances() -> Vec<Array2<f32>> {
    let song = bailando_testkit::shared("model/bootstrap/demo_decode_hop15.npy");
    let mut dances: Vec<_> =
        song.into_iter().map(|path| ndarray_npy::read_npy(path).unwrap()).collect();
    if let Some(folder) = bailando_testkit::shared("data/salsa") {
        let some = recordings(&folder).into_iter().step_by(9);
        dances.extend(some.map(|(_, positions)| decoded_from(&positions)));
    }
    dances
}

fn at(positions: &Positions, frame: usize, joint: usize) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|axis| positions[[frame, joint, axis]]))
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

/// Median speed along the floor of feet that are within 5 cm of it, cm/s.
fn skate(positions: &Positions) -> f32 {
    let steps = (1..positions.dim().0).flat_map(|frame| FEET.map(|foot| (frame, foot)));
    let low = steps.filter(|&(frame, foot)| at(positions, frame, foot).y < 0.05);
    let speeds = low.map(|(frame, foot)| {
        let step = at(positions, frame, foot) - at(positions, frame - 1, foot);
        step.with_y(0.0).length() * 6000.0
    });
    median(speeds.collect())
}

/// Largest change of a joint's step from one frame to the next, metres.
fn hardest(positions: &Positions) -> f32 {
    let frames = 1..positions.dim().0 - 1;
    let all = frames.flat_map(|frame| (0..24).map(move |joint| (frame, joint)));
    let change = |(frame, joint)| {
        let [before, now, after] = [frame - 1, frame, frame + 1].map(|f| at(positions, f, joint));
        (after - 2.0 * now + before).length()
    };
    all.map(change).fold(0.0, f32::max)
}

/// World rotation of a joint.
fn turn(skeleton: &Skeleton, pose: &[Quat], joint: usize) -> Quat {
    let above = skeleton.parent(joint).map_or(Quat::IDENTITY, |up| turn(skeleton, pose, up));
    above * pose[joint]
}

/// Height of the lowest point of the soles in all frames, metres: heel, ball and toe tip.
fn lowest(done: &Finished) -> f32 {
    let skeleton = skeleton();
    let mut lowest = f32::INFINITY;
    for (frame, pose) in done.animation.rotations.iter().enumerate() {
        for foot in FEET {
            let (ankle, offset) = (skeleton.parent(foot).unwrap(), skeleton.offset(foot));
            let ahead = offset.with_y(0.0);
            let heel = Vec3::Y * (offset.y - 0.015) - 0.4 * ahead;
            let tip = 0.5 * ahead - Vec3::Y * 0.015;
            let ball = at(&done.positions, frame, foot);
            for point in [
                at(&done.positions, frame, ankle) + turn(&skeleton, pose, ankle) * heel,
                ball + turn(&skeleton, pose, foot) * tip,
                ball - Vec3::Y * 0.015,
            ] {
                lowest = lowest.min(point.y);
            }
        }
    }
    lowest
}

fn bend(positions: &Positions, frame: usize, [a, b, c]: [usize; 3]) -> f32 {
    let [a, b, c] = [a, b, c].map(|joint| at(positions, frame, joint));
    (b - a).angle_between(c - b).to_degrees()
}

#[test]
fn feet_stand_still_above_the_floor() {
    for decoded in dances() {
        let (raw, clean) = (finish(&decoded, false), finish(&decoded, true));
        let (before, after) = (skate(&raw.positions), skate(&clean.positions));
        println!("skate {before:.1} to {after:.1} cm/s, lowest {:.4} m", lowest(&clean));
        assert!(after < 5.0 && after < before);
        let shaken = hardest(&clean.positions);
        println!("hardest acceleration {:.3} m a frame squared", shaken);
        assert!(shaken < 0.04, "{shaken}");
        assert!(lowest(&clean) > -0.005, "{} m", lowest(&clean));
        assert_continuous_unit_quaternions(&clean.animation);
        assert_eq!(clean.positions, posed(&clean.animation));
    }
}

#[test]
fn limbs_stay_within_their_limits_and_near_where_they_were() {
    for decoded in dances() {
        let (raw, clean) = (finish(&decoded, false), finish(&decoded, true));
        for frame in 0..clean.positions.dim().0 {
            for limb in [[16, 18, 20], [17, 19, 21], [1, 4, 7], [2, 5, 8]] {
                assert!(bend(&clean.positions, frame, limb) < 150.0);
            }
            let moved =
                |joint| at(&clean.positions, frame, joint) - at(&raw.positions, frame, joint);
            assert!(moved(15).length() < 0.10, "the head moves with the root alone");
            // A knee that comes out of the hinge's plane would be somewhere else.
            for knee in [4, 5] {
                assert!(moved(knee).length() < 0.20, "frame {frame}: {}", moved(knee));
            }
        }
    }
}

/// Joints of neither leg: feet that stand still, as they do not before, move a beat of their own.
const UPPER_BODY: [usize; 18] = [0, 1, 2, 3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23];

#[test]
fn dance_beats_stay_within_a_frame() {
    let (mut near, mut all) = (0, 0);
    for decoded in dances() {
        let beats = |clean| {
            let positions = finish(&decoded, clean).positions.select(Axis(1), &UPPER_BODY);
            dance_beats(&joint_speed(decoded_from(&positions).view()))
        };
        let (before, after) = (beats(false), beats(true));
        let is_near = |beat: usize| after.iter().any(|other| other.abs_diff(beat) <= 1);
        near += before.iter().filter(|&&beat| is_near(beat)).count();
        all += before.len();
    }
    println!("{near} of {all} beats within a frame");
    assert!(near as f64 >= 0.9 * all as f64);
}

#[test]
fn a_clean_motion_in_pieces_is_the_whole_but_for_its_floor() {
    let decoded = fixture("decode_raw.npy");
    let options = FinishOptions::default();
    let whole = finish(&decoded, true);
    for piece in [7, 64, 333] {
        let mut finisher = Finisher::whole(&skeleton(), &options).unwrap();
        for rows in decoded.axis_chunks_iter(Axis(0), piece) {
            assert_eq!(finisher.push(rows).unwrap().positions.dim().0, 0);
        }
        assert_eq!(finisher.end().unwrap(), whole, "pieces of {piece}");
    }
    // A stream settles its floor earlier: as many frames, and each once.
    let mut stream = Finisher::new(&skeleton(), &options).unwrap();
    let pieces = decoded.axis_chunks_iter(Axis(0), 64);
    let mut frames: usize = pieces.map(|rows| stream.push(rows).unwrap().positions.dim().0).sum();
    assert!(frames > 0);
    frames += stream.end().unwrap().positions.dim().0;
    assert_eq!(frames, whole.positions.dim().0);
}

/// The same dance in two clips, the second as if another decoder had made it: of other legs, a
/// little aside, and on a floor of its own.
#[test]
fn a_clip_that_continues_another_has_no_seam() {
    let cut = 300;
    for decoded in dances().into_iter().filter(|decoded| decoded.nrows() > 2 * cut) {
        let part = |from: usize, to: usize| {
            decoded.slice_axis(Axis(0), Slice::from(from..to.min(decoded.nrows()))).to_owned()
        };
        let options = FinishOptions::default();
        let mut first = Finisher::whole(&skeleton(), &options).unwrap();
        first.push(part(0, cut).view()).unwrap();
        let before = first.end().unwrap().positions;
        let place = [at(&before, cut - 1, 0).x + 0.03, at(&before, cut - 1, 0).z - 0.02];
        let options = FinishOptions { start: place, ..options };
        let next = Finisher::whole(&skeleton(), &options).unwrap();
        let mut next = next.continuing(first.seam().unwrap()).unwrap();
        let mut rows = part(cut, cut + 300);
        rows.columns_mut().into_iter().skip(3).for_each(|mut column| column *= 0.97);
        next.push(rows.view()).unwrap();
        let after = next.end().unwrap().positions;

        let joined = ndarray::concatenate(Axis(0), &[before.view(), after.view()]).unwrap();
        let step = |frame: usize, joint| at(&joined, frame + 1, joint) - at(&joined, frame, joint);
        let largest = |frames: std::ops::Range<usize>, value: &dyn Fn(usize, usize) -> f32| {
            let all = frames.flat_map(|frame| (0..24).map(move |joint| (frame, joint)));
            all.map(|(frame, joint)| value(frame, joint)).fold(0.0, f32::max)
        };
        let speed = |frame: usize, joint: usize| step(frame, joint).length();
        let change =
            |frame: usize, joint: usize| (step(frame + 1, joint) - step(frame, joint)).length();
        let seam = (largest(cut - 1..cut, &speed), largest(cut - 2..cut, &change));
        let inside = (largest(0..cut - 1, &speed), largest(0..cut - 2, &change));
        println!("seam {seam:?}, inside {inside:?}");
        assert!(seam.0 <= inside.0 && seam.1 <= inside.1);
    }
}
