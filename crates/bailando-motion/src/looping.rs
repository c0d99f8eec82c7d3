//! Loops: the part of a motion whose end is most like its start, made to flow into it.

use std::ops::Range;

use glam::{Quat, Vec3};

use crate::{
    animation::{Animation, FrameQueue},
    clean::feet::FeetPlanter,
    error::MotionError,
    seam::turn,
    skeleton::Skeleton,
    smooth::hermite,
};

/// Seconds before the end over which what differs from the start is blended in.
const BLEND: f32 = 0.7;
/// Seconds of the root's velocity that weigh as much as its place, and of a joint's angular
/// velocity that weigh as much as its pose: less, for there are many joints.
const RATES: [f32; 2] = [0.15, 0.0375];
/// What a radian of heading and a metre of the path, which are taken back over the whole part,
/// weigh against those that are blended in.
const TRAVEL: f32 = 0.5;

/// Returns which of `parts`, ranges of frames, ends most like it begins, and by how much its end
/// differs from its start; none if there are none inside the motion.
///
/// The difference is in radians, summed over all joints: the angle between both poses and 0.0375 s
/// of the difference of their angular velocities. To it come those of the root, where a metre is a
/// radian: of its height and 0.15 s of its velocity, both after the heading was made the same, and
/// half of the heading and of the way on the floor.
#[must_use]
pub fn best_loop(motion: &Animation, parts: &[Range<usize>]) -> Option<(usize, f32)> {
    let inside = |part: &Range<usize>| part.start < part.end && part.end < motion.root.len();
    let inside = parts.iter().enumerate().filter(|(_, part)| inside(part));
    let costs = inside.map(|(index, part)| (index, gap(motion, part)));
    costs.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Makes a loop of a part of a motion: its frame after the last would be its first, in pose, speed,
/// heading and place. The way that the part travels and turns is taken back steadily; feet are held
/// in place again if they are to be `planted`.
///
/// # Errors
/// [`MotionError::Skeleton`] if the skeleton contradicts itself, [`MotionError::Shape`] if the part
/// and one frame more are not inside the motion, or its poses are not the skeleton's.
pub fn close_loop(
    skeleton: &Skeleton,
    motion: &Animation,
    part: Range<usize>,
    planted: bool,
) -> Result<Animation, MotionError> {
    skeleton.validate()?;
    let joints = skeleton.joints.len();
    let fits = part.start < part.end && part.end < motion.root.len();
    if !fits || motion.rotations.iter().any(|pose| pose.len() != joints) {
        return Err(MotionError::Shape {
            expected: format!("a part of {} frames of {joints} joints", motion.root.len()),
            got: format!("frames {} to {}", part.start, part.end),
        });
    }
    let mut closed = blended(&returning(motion, &part), motion.fps);
    if planted {
        // Between two others, so that a foot that stands across the seam does so in all of them.
        let mut planter = FeetPlanter::new(skeleton, motion.fps, false);
        let mut all = Animation::empty(motion.fps);
        for _ in 0..3 {
            all.push_frames(planter.push(closed.clone()));
        }
        all.push_frames(planter.end());
        let frames = closed.root.len();
        all.take_frames(frames);
        closed = all.take_frames(frames);
    }
    make_continuous(&mut closed);
    Ok(closed)
}

fn heading(pelvis: Quat) -> f32 {
    let ahead = pelvis * Vec3::Z;
    ahead.x.atan2(ahead.z)
}

/// The angle about +y from one heading to another, the shorter way.
fn turned(from: Quat, to: Quat) -> f32 {
    let angle = heading(to) - heading(from);
    angle.sin().atan2(angle.cos())
}

/// How much the end of a part differs from its start, as [`best_loop`] says.
fn gap(motion: &Animation, part: &Range<usize>) -> f32 {
    let Animation { fps, root, rotations } = motion;
    let (start, end) = (part.start, part.end);
    let [of_root, of_joint] = RATES.map(|seconds| seconds * *fps as f32);
    let around = turned(rotations[start][0], rotations[end][0]);
    let back = Quat::from_rotation_y(-around);
    let mut sum = (root[end].y - root[start].y).abs();
    let step = |frame: usize| root[frame + 1] - root[frame];
    sum += of_root * (back * step(end - 1)).distance(step(start));
    for joint in 0..rotations[start].len() {
        // Only the pelvis is turned in the world.
        let back = if joint == 0 { back } else { Quat::IDENTITY };
        let at = rotations_of(rotations, joint);
        let spin = |frame: usize| turn(at(frame), at(frame + 1));
        sum += turn(back * at(end), at(start)).length();
        sum += of_joint * (back * spin(end - 1)).distance(spin(start));
    }
    let travelled = (root[end] - root[start]).with_y(0.0).length();
    sum + TRAVEL * (around.abs() + travelled)
}

/// The rotation of one joint in any frame.
fn rotations_of(rotations: &[Vec<Quat>], joint: usize) -> impl Fn(usize) -> Quat {
    move |frame| rotations[frame][joint]
}

/// Returns a part and the frame after it, whose heading and place on the floor are those of its
/// first frame again.
fn returning(motion: &Animation, part: &Range<usize>) -> Animation {
    let frames = part.end - part.start;
    let root = &motion.root[part.start..=part.end];
    let mut rotations = motion.rotations[part.start..=part.end].to_vec();
    let around = turned(rotations[0][0], rotations[frames][0]);
    let turn_at = |frame: usize| Quat::from_rotation_y(-around * frame as f32 / frames as f32);
    let mut path = vec![root[0]];
    for (frame, step) in root.windows(2).enumerate() {
        path.push(path[frame] + turn_at(frame) * (step[1] - step[0]));
    }
    let away = (path[frames] - path[0]).with_y(0.0);
    for (frame, (place, pose)) in path.iter_mut().zip(&mut rotations).enumerate() {
        *place -= away * (frame as f32 / frames as f32);
        pose[0] = turn_at(frame) * pose[0];
    }
    Animation { fps: motion.fps, root: path, rotations }
}

/// Drops the last frame, after the frames before it were blended to become the first one there, at
/// its speed.
fn blended(motion: &Animation, fps: u32) -> Animation {
    let Animation { root, rotations, .. } = motion;
    let frames = root.len() - 1;
    let length = ((BLEND * fps as f32) as usize).clamp(1, frames);
    let next = 1.min(frames);
    let at_end = |value: Vec3, rate: Vec3| (value.as_dvec3(), rate.as_dvec3());
    let rise = root[0] - root[frames];
    let speed = (root[next] - root[0]) - (root[frames] - root[frames - 1]);
    let mut targets = vec![at_end(rise, speed)];
    for joint in 0..rotations[0].len() {
        let at = rotations_of(rotations, joint);
        let speed = turn(at(0), at(next)) - turn(at(frames - 1), at(frames));
        targets.push(at_end(turn(at(frames), at(0)), speed));
    }
    let still = at_end(Vec3::ZERO, Vec3::ZERO);
    let mut closed = Animation::empty(fps);
    for frame in 0..frames {
        let (mut place, mut pose) = (root[frame], rotations[frame].clone());
        let since = (frame + length).saturating_sub(frames) as f64;
        if since > 0.0 {
            let part = |target| hermite(still, target, since, length as f64).as_vec3();
            place += part(targets[0]);
            for (rotation, &target) in pose.iter_mut().zip(&targets[1..]) {
                *rotation = (Quat::from_scaled_axis(part(target)) * *rotation).normalize();
            }
        }
        closed.root.push(place);
        closed.rotations.push(pose);
    }
    closed
}

fn make_continuous(motion: &mut Animation) {
    let mut last: Vec<Quat> = Vec::new();
    for pose in &mut motion.rotations {
        for (rotation, last) in pose.iter_mut().zip(&last) {
            if rotation.dot(*last) < 0.0 {
                *rotation = -*rotation;
            }
        }
        last.clone_from(pose);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dancer who turns, walks, and swings with a period of 60 frames and a slow drift.
    fn dancer(frames: usize) -> Animation {
        let pose = |frame: usize| {
            let time = frame as f32 / 60.0;
            let swing = (time * std::f32::consts::TAU).sin();
            let mut pose = vec![Quat::IDENTITY; 24];
            pose[0] = Quat::from_rotation_y(0.4 * time) * Quat::from_rotation_x(0.1 * swing);
            pose[1] = Quat::from_rotation_x(0.3 * swing + 0.05 * time);
            pose[18] = Quat::from_rotation_z(0.8 * swing - 0.1 * time);
            pose
        };
        let place = |frame: usize| Vec3::new(0.01 * frame as f32, 0.96, 0.002 * frame as f32);
        Animation {
            fps: 60,
            root: (0..frames).map(place).collect(),
            rotations: (0..frames).map(pose).collect(),
        }
    }

    #[test]
    fn the_end_flows_into_the_start() {
        let motion = dancer(400);
        for planted in [false, true] {
            let closed = close_loop(&Skeleton::fixture(), &motion, 30..265, planted).unwrap();
            assert_eq!((closed.root.len(), closed.rotations.len()), (235, 235));
            let last = closed.root.len() - 1;
            let frame = |at: usize| at % closed.root.len();
            let inside = |at: usize| {
                let [a, b, c] = [at, at + 1, at + 2].map(frame);
                let path = closed.root[a] - 2.0 * closed.root[b] + closed.root[c];
                let bends = (0..24).map(|joint| {
                    let [a, b, c] = [a, b, c].map(|at| closed.rotations[at][joint]);
                    (turn(b, c) - turn(a, b)).length()
                });
                (path.length(), bends.fold(0.0, f32::max))
            };
            let most = (0..last - 2).map(inside);
            let most = most.fold((0.0_f32, 0.0_f32), |m, v| (m.0.max(v.0), m.1.max(v.1)));
            for seam in [last - 1, last] {
                let (path, bend) = inside(seam);
                assert!(path < 1.5 * most.0 + 1e-3, "{planted}: path {path}, inside {}", most.0);
                assert!(bend < 1.5 * most.1 + 1e-2, "{planted}: bend {bend}, inside {}", most.1);
            }
        }
    }

    #[test]
    fn the_part_that_ends_as_it_begins_is_taken() {
        let motion = dancer(400);
        // Whole periods close better than others, short ones better than long ones.
        let parts = [10..85, 20..140, 30..270, 0..1000, 9..9];
        let best = best_loop(&motion, &parts).unwrap();
        assert_eq!(best.0, 1);
        assert_eq!(best_loop(&motion, &parts[3..]), None);
        // In two seconds: 0.8 rad of heading and 1.224 m count half, then 0.1 and 0.2 rad of drift.
        let expected = 0.5 * (0.8 + 1.224) + 0.1 + 0.2;
        assert!((best.1 - expected).abs() < 0.12, "{} for {expected}", best.1);
        assert!(close_loop(&Skeleton::fixture(), &motion, 0..400, true).is_err());
    }
}
