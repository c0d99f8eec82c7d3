//! Judging motions: units, axes, frame rate, sides, bones, jumps, floor.

use bailando::motion::Skeleton;
use glam::DVec3;

use super::{
    facts::{MotionFacts, measure},
    findings::{Findings, Topic, file_name},
};
use crate::data::{MotionSource, Piece};

/// Frames of one training crop (ARCHITECTURE section 6).
pub(super) const CROP: usize = 240;

/// Sizes of people, against the skeleton: children to giants.
const PERSON: std::ops::RangeInclusive<f64> = 0.6..=1.6;
/// Units that data come in, and how many of them a metre has.
const UNITS: [(&str, f64); 4] =
    [("centimetres", 100.0), ("millimetres", 1_000.0), ("inches", 39.37), ("feet", 3.281)];
/// Share of the body's direction that must be along y; dancers bend and roll.
const UPRIGHT: f64 = 0.5;
/// Bones of a motion-capture skeleton vary by less than that.
const BONE_CHANGE: f64 = 0.03;
/// Metres.
const BONE_DIFFERENCE: f64 = 0.02;
/// Metres per second: hands in fast motion reach about 10.
const JUMP: f64 = 15.0;
/// The pelvis of a person, metres per second, with room for a jump or two.
const ROOT_JUMP: f64 = 40.0;
/// Metres between the lowest and the highest place of the pelvis: no dancer jumps that high.
const ROOT_RISE: f64 = 5.0;
/// Metres per second, mean over all joints.
const STILL: f64 = 0.03;
/// Metres: standing feet of the recordings are at 0.006 to 0.022 (DESIGN).
const FLOOR: std::ops::RangeInclusive<f64> = -0.05..=0.10;

/// Reads and judges one motion; the number of frames where it can be used.
pub(super) fn check(
    source: &MotionSource,
    pieces: &[&Piece],
    skeleton: &Skeleton,
    findings: &mut Findings,
) -> Option<usize> {
    let name = file_name(source.path());
    let positions = match source.positions(skeleton) {
        Ok(positions) => positions,
        Err(error) => {
            findings.add(Topic::MotionFile, error.to_string());
            return None;
        }
    };
    let facts = measure(&positions, skeleton);
    declared(&facts, pieces, &name, findings);
    if let Some(frame) = facts.not_finite {
        findings.add(Topic::NotFinite, format!("{name}: first in frame {frame}"));
        return None;
    }
    if facts.frames < CROP {
        findings.add(Topic::Short, format!("{name}: {} frames", facts.frames));
    }
    if facts.frames > 1 {
        judge(&facts, skeleton, &name, findings);
    }
    Some(facts.frames)
}

fn declared(facts: &MotionFacts, pieces: &[&Piece], name: &str, findings: &mut Findings) {
    for piece in pieces {
        let id = &piece.id;
        if let Some(fps) = piece.fps.filter(|fps| (fps - 60.0).abs() > 0.5) {
            findings.add(Topic::FrameRate, format!("{id}: the index says fps {fps}"));
        }
        if let Some(frames) = piece.frames.filter(|&frames| frames != facts.frames) {
            let found = facts.frames;
            findings.add(
                Topic::DeclaredLength,
                format!("{id}: frames {frames} in the index, {found} in {name}"),
            );
        }
        let seconds = facts.frames as f64 / 60.0;
        if let Some(said) = piece.seconds.filter(|said| (said - seconds).abs() > 0.1) {
            let rate = facts.frames as f64 / said;
            findings.add(
                Topic::DeclaredLength,
                format!(
                    "{id}: {said} s in the index, but {name} lasts {seconds:.2} s at 60 frames \
                         a second ({rate:.1} a second would fit)"
                ),
            );
        }
    }
}

fn judge(facts: &MotionFacts, skeleton: &Skeleton, name: &str, findings: &mut Findings) {
    // Each of these makes the measures after it meaningless: one finding, not five.
    if !PERSON.contains(&facts.scale) {
        findings.add(Topic::Units, format!("{name}: {}", unit(facts.scale)));
        return;
    }
    if facts.root_rise > ROOT_RISE || facts.root_fastest > ROOT_JUMP && facts.floor.abs() > 10.0 {
        findings.add(
            Topic::RootUnits,
            format!(
                "{name}: the feet are at height {:.0}, the root moves by {:.0} up and down, at up \
                 to {:.0} a second",
                facts.floor, facts.root_rise, facts.root_fastest
            ),
        );
        return;
    }
    if facts.up.y < UPRIGHT {
        findings.add(Topic::Axes, format!("{name}: {}", direction(facts.up)));
        return;
    }
    if facts.repeated > 0.3 {
        let rate = 60.0 * (1.0 - facts.repeated);
        let share = 100.0 * facts.repeated;
        findings.add(
            Topic::FrameRate,
            format!(
                "{name}: {share:.0} % of the frames repeat the one before, as if {rate:.0} a \
                     second had been stretched"
            ),
        );
    }
    if facts.swapped > 0.8 {
        let share = 100.0 * facts.swapped;
        findings.add(Topic::Sides, format!("{name}: in {share:.0} % of the frames"));
    }
    judge_bones(facts, skeleton, name, findings);
    judge_movement(facts, skeleton, name, findings);
}

fn judge_bones(facts: &MotionFacts, skeleton: &Skeleton, name: &str, findings: &mut Findings) {
    let (change, joint) = facts.bone_change;
    if change > BONE_CHANGE {
        let percent = 100.0 * change;
        let joint = joint_name(skeleton, joint);
        findings
            .add(Topic::BonesVary, format!("{name}: the bone to {joint} by up to {percent:.0} %"));
    }
    let (difference, joint) = facts.bone_difference;
    if difference > BONE_DIFFERENCE {
        let joint = joint_name(skeleton, joint);
        let centimetres = 100.0 * difference;
        findings
            .add(Topic::BonesDiffer, format!("{name}: the bone to {joint} by {centimetres:.1} cm"));
    }
}

fn judge_movement(facts: &MotionFacts, skeleton: &Skeleton, name: &str, findings: &mut Findings) {
    let (speed, frame, joint) = facts.fastest;
    if speed > JUMP {
        let joint = joint_name(skeleton, joint);
        findings.add(Topic::Jumps, format!("{name}: {joint} at {speed:.0} m/s in frame {frame}"));
    }
    if facts.speed < STILL {
        let speed = 100.0 * facts.speed;
        findings.add(Topic::Still, format!("{name}: joints move at {speed:.1} cm/s on average"));
    }
    if !FLOOR.contains(&facts.floor) {
        let (height, side) = (100.0 * facts.floor.abs(), side(facts.floor));
        findings.add(Topic::Floor, format!("{name}: {height:.0} cm {side} it"));
    }
}

fn side(height: f64) -> &'static str {
    if height > 0.0 { "above" } else { "below" }
}

fn joint_name(skeleton: &Skeleton, joint: usize) -> String {
    let name = skeleton.joints.get(joint).cloned();
    name.unwrap_or_else(|| format!("joint {joint}"))
}

fn unit(scale: f64) -> String {
    let near = UNITS.iter().find(|(_, per_metre)| PERSON.contains(&(scale / per_metre)));
    match near {
        Some((name, per_metre)) => {
            let factor = 1.0 / per_metre;
            format!(
                "bones are {scale:.1} times as long as expected: these look like {name}; factor \
                 {factor:.4}"
            )
        }
        None => {
            let factor = 1.0 / scale.max(1e-9);
            format!("bones are {scale:.3} times as long as expected; factor {factor:.4}")
        }
    }
}

fn direction(up: DVec3) -> String {
    let axis = up.abs().max_position();
    if up[axis].abs() < UPRIGHT {
        return "the figure lies, rolls or turns over most of the time".into();
    }
    let sign = if up[axis] > 0.0 { '+' } else { '-' };
    format!("from feet to head is {sign}{}", ["x", "y", "z"][axis])
}
