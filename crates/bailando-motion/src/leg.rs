//! Legs of fixed length on the decoder's steps: every leg of a solved animation is bent so that its
//! foot is where the decoder has it.
//!
//! Directions alone are not enough: a decoder shrinks and stretches its legs, by up to a third, and
//! a skeleton that only copies their directions has its feet in the air or in the floor.

use glam::{DQuat, DVec3, Vec3};
use ndarray::ArrayView2;

use super::{
    Animation, Positions, Skeleton,
    fit::smallest_rotation,
    frames,
    inverse::{SHORTEST_BONE, TWIST_RATE},
    smooth::smooth_upper_bound,
    two_bones::{TwoBones, across},
};

/// A foot this close to where it should be is left alone, metres: what single precision makes of a
/// motion that has the skeleton's lengths.
const ALREADY_THERE: f64 = 1e-5;
/// A leg carries weight while its foot is within the first of these of the lower foot's height, and
/// does not any more from the second on, metres. Only such a leg pulls the root down.
const STANDING: (f64, f64) = (0.02, 0.10);
/// The root is never lowered further than this, metres.
const MOST_LOWERED: f64 = 0.05;
/// Fastest turn of a knee about the line from hip to ankle where all of its bend is this leg's own,
/// radians a second; a fast spin. Decoders turn a dancer round by folding hips through each other.
const KNEE_RATE: f64 = 12.0;
/// Seconds that lowering the root starts before it is needed and ends after.
const LOWERING_SECONDS: f64 = 0.2;

/// The legs of a skeleton: every chain of three joints with one child each above a foot.
#[derive(Clone, Debug)]
pub(super) struct Legs {
    legs: Vec<Leg>,
}

#[derive(Clone, Debug)]
struct Leg {
    /// From the root down to the hip's parent.
    above: Vec<(usize, DVec3)>,
    /// Hip, knee, ankle and foot.
    joints: [usize; 4],
    /// Offsets of the four from their parents.
    offsets: [DVec3; 4],
    bones: TwoBones,
}

/// What a leg of the skeleton has to follow in one frame.
struct Task {
    /// World rotation of the hip's parent, and the hip's place.
    above: DQuat,
    hip: DVec3,
    /// Where the ankle and the foot belong.
    ankle: DVec3,
    foot: DVec3,
    /// Share of its own length to which the decoder's leg is extended.
    extension: f64,
    /// How the decoder's knee stands off its line from hip to ankle, turned onto this leg's line.
    bend: DVec3,
    /// Unit vector from hip to ankle.
    axis: DVec3,
    distance: f64,
}

impl Legs {
    /// Finds the legs of a valid skeleton; one without such chains has none.
    pub(super) fn new(skeleton: &Skeleton) -> Self {
        let feet = skeleton.foot_joints().into_iter();
        Self {
            legs: feet
                .filter_map(|foot| Leg::above_foot(skeleton, foot))
                .collect(),
        }
    }

    /// Starts to bend legs, frame by frame, at `fps`.
    pub(super) fn start(self, fps: u32) -> Following {
        Following {
            gaits: vec![Gait::default(); self.legs.len()],
            legs: self,
            half_width: (LOWERING_SECONDS * f64::from(fps)).ceil() as usize,
            missing: Vec::new(),
            done: 0,
            solved: Animation::empty(fps),
            decoded: Positions::zeros((0, 0, 3)),
        }
    }

    /// How much lower the root must be in each frame for the standing legs to reach, metres.
    fn missing_reach(&self, animation: &Animation, decoded: &Positions) -> Vec<f64> {
        let frames = animation.root.len();
        (0..frames)
            .map(|frame| {
                let pose = decoded.index_axis(ndarray::Axis(0), frame);
                let height = |leg: &Leg| place(pose, leg.joints[3]).y;
                let lowest = self.legs.iter().map(height).fold(f64::INFINITY, f64::min);
                let missing = self.legs.iter().map(|leg| {
                    let task = leg.task(animation, frame, pose);
                    let reached = leg.bones.reach(task.distance, task.extension);
                    // A root lowered by one metre comes nearer by the axis' fall.
                    let missing = (task.distance - reached).max(0.0) / (-task.axis.y).max(0.5);
                    missing * weight_carried(height(leg) - lowest)
                });
                missing.fold(0.0, f64::max).min(MOST_LOWERED)
            })
            .collect()
    }
}

/// Bends the legs of an animation, solved from decoded positions frame by frame, to the feet of those
/// positions. Where a leg that stands is too short, the root is lowered a little and slowly: what comes
/// in leaves when that is known.
#[derive(Clone, Debug)]
pub(super) struct Following {
    legs: Legs,
    gaits: Vec<Gait>,
    half_width: usize,
    /// How much lower the root must be, in every frame so far.
    missing: Vec<f64>,
    /// Frames that have left.
    done: usize,
    solved: Animation,
    decoded: Positions,
}

/// What a leg remembers of the frame before.
#[derive(Clone, Copy, Debug, Default)]
struct Gait {
    rotations: Option<[DQuat; 3]>,
    side: Option<DVec3>,
}

impl Following {
    /// Takes the next frames in; what is known to the end leaves.
    pub(super) fn push(&mut self, solved: Animation, decoded: &Positions) -> Animation {
        self.missing
            .extend(self.legs.missing_reach(&solved, decoded));
        self.solved.append(solved);
        frames::append(&mut self.decoded, decoded.clone());
        // The lowering of a frame depends on those within two half widths.
        self.leave(self.missing.len().saturating_sub(2 * self.half_width))
    }

    /// The rest.
    pub(super) fn end(&mut self) -> Animation {
        self.leave(self.missing.len())
    }

    fn leave(&mut self, end: usize) -> Animation {
        let count = end.saturating_sub(self.done);
        let mut animation = self.solved.take_front(count);
        let decoded = frames::take_front(&mut self.decoded, count);
        let margin = 2 * self.half_width;
        let first = self.done.saturating_sub(margin);
        let near = self.missing.iter().copied().take(end + margin).skip(first);
        let near: Vec<f64> = near.collect();
        let lowered = smooth_upper_bound(&near, self.half_width);
        let lowered = lowered.into_iter().skip(self.done - first);
        for (root, lowered) in animation.root.iter_mut().zip(lowered) {
            root.y -= lowered as f32;
        }
        for (leg, gait) in self.legs.legs.iter().zip(&mut self.gaits) {
            leg.follow(&mut animation, &decoded, gait);
        }
        self.done += count;
        animation
    }
}

impl Leg {
    fn above_foot(skeleton: &Skeleton, foot: usize) -> Option<Self> {
        let ankle = skeleton.parent(foot)?;
        let knee = skeleton.parent(ankle)?;
        let hip = skeleton.parent(knee)?;
        let mut above = Vec::new();
        let mut next = skeleton.parent(hip);
        while let Some(joint) = next {
            above.push((joint, offset(skeleton, joint)));
            next = skeleton.parent(joint);
        }
        above.reverse();
        let joints = [hip, knee, ankle, foot];
        let offsets = joints.map(|joint| offset(skeleton, joint));
        let [_, thigh, shank, sole] = offsets.map(DVec3::length);
        let children = |joint: usize| {
            let parents = (0..skeleton.joints.len()).map(|child| skeleton.parent(child));
            parents.filter(|&parent| parent == Some(joint)).count()
        };
        let is_leg = !above.is_empty()
            && joints[..3].iter().all(|&joint| children(joint) == 1)
            && [thigh, shank, sole].iter().all(|&l| l > SHORTEST_BONE);
        is_leg.then_some(Self {
            above,
            joints,
            offsets,
            bones: TwoBones { thigh, shank },
        })
    }

    fn follow(&self, animation: &mut Animation, decoded: &Positions, gait: &mut Gait) {
        let seconds = 1.0 / f64::from(animation.fps.max(1));
        for (frame, pose) in decoded.outer_iter().enumerate() {
            let task = self.task(animation, frame, pose);
            let solved = self.rotations(animation, frame);
            let before = gait.rotations;
            let now = self.knee_side(&task, gait.side, KNEE_RATE * seconds);
            let turned = if self.is_there(&task, solved) {
                solved
            } else {
                self.turn(&task, now, before, solved, TWIST_RATE * seconds)
            };
            let turned = match before {
                Some(before) => [0, 1, 2].map(|i| nearer_sign(turned[i], before[i])),
                None => turned,
            };
            for (&joint, rotation) in self.joints.iter().zip(turned) {
                animation.rotations[frame][joint] = rotation.as_quat().normalize();
            }
            *gait = Gait {
                rotations: Some(turned),
                side: Some(now),
            };
        }
    }

    fn rotations(&self, animation: &Animation, frame: usize) -> [DQuat; 3] {
        let pose = &animation.rotations[frame];
        [0, 1, 2].map(|i| pose[self.joints[i]].as_dquat().normalize())
    }

    fn task(&self, animation: &Animation, frame: usize, pose: ArrayView2<'_, f32>) -> Task {
        let mut above = DQuat::IDENTITY;
        let mut at = animation.root[frame].as_dvec3();
        for (index, &(joint, offset)) in self.above.iter().enumerate() {
            if index > 0 {
                at += above * offset;
            }
            above = (above * animation.rotations[frame][joint].as_dquat()).normalize();
        }
        let hip = at + above * self.offsets[0];
        let [own_hip, own_knee, own_ankle, foot] = self.joints.map(|joint| place(pose, joint));
        // The foot is what stands on the floor, so it is the foot that is met: the ankle lies
        // behind it by the skeleton's length in the decoder's direction.
        let sole = foot - own_ankle;
        let ankle = match sole.try_normalize() {
            Some(towards) if sole.length() > SHORTEST_BONE => {
                foot - towards * self.offsets[3].length()
            }
            _ => own_ankle,
        };
        let down = above * DVec3::NEG_Y;
        let (line, own_line) = (ankle - hip, own_ankle - own_hip);
        let axis = line.try_normalize().unwrap_or(down);
        let own_axis = own_line.try_normalize().unwrap_or(axis);
        let own_length = (own_knee - own_hip).length() + (own_ankle - own_knee).length();
        Task {
            above,
            hip,
            ankle,
            foot,
            extension: own_line.length() / own_length.max(SHORTEST_BONE),
            bend: DQuat::from_rotation_arc(own_axis, axis) * across(own_knee - own_hip, own_axis),
            axis,
            distance: line.length(),
        }
    }

    /// Whether the solved rotations bring this leg's ankle and foot where they belong.
    fn is_there(&self, task: &Task, [hip, knee, ankle]: [DQuat; 3]) -> bool {
        let [_, thigh, shank, sole] = self.offsets;
        let hip = task.above * hip;
        let knee = hip * knee;
        let at_ankle = task.hip + hip * thigh + knee * shank;
        let at_foot = at_ankle + knee * ankle * sole;
        (at_ankle - task.ankle).length() < ALREADY_THERE
            && (at_foot - task.foot).length() < ALREADY_THERE
    }

    /// The unit vector in which the knee stands off: the decoder's, and as far as this leg must bend
    /// more than that, the front. What is not the decoder's turns by at most `max_turn` radians.
    fn knee_side(&self, task: &Task, before: Option<DVec3>, max_turn: f64) -> DVec3 {
        let distance = self.bones.reach(task.distance, task.extension);
        let (off, _) = self.bones.knee(distance);
        let more = (off - task.bend.length()).max(0.0);
        let side = across(task.bend + more * self.front(task), task.axis);
        let carried = before.and_then(|before| across(before, task.axis).try_normalize());
        let side = match side.try_normalize() {
            Some(unit) if side.length() > SHORTEST_BONE => unit,
            _ => return carried.unwrap_or_else(|| task.axis.any_orthonormal_vector()),
        };
        let Some(carried) = carried else {
            return side;
        };
        let angle = carried.cross(side).dot(task.axis).atan2(carried.dot(side));
        // A leg of the decoder's lengths copies its knee, however fast that turns.
        let permitted = max_turn * off / more.max(SHORTEST_BONE);
        if angle.abs() <= permitted {
            return side;
        }
        DQuat::from_axis_angle(task.axis, angle.clamp(-permitted, permitted)) * carried
    }

    /// Where the rest pose's front (+z) is for this leg, swung to where it is without twist.
    fn front(&self, task: &Task) -> DVec3 {
        let rest = (self.offsets[1] + self.offsets[2]).normalize_or(DVec3::NEG_Y);
        let swung = DQuat::from_rotation_arc(rest, task.above.inverse() * task.axis);
        task.above * swung * across(DVec3::Z, rest).normalize_or_zero()
    }

    /// Local rotations of hip, knee and ankle that take the leg to its task, each the smallest one.
    fn turn(
        &self,
        task: &Task,
        side: DVec3,
        before: Option<[DQuat; 3]>,
        solved: [DQuat; 3],
        max_twist: f64,
    ) -> [DQuat; 3] {
        let distance = self.bones.reach(task.distance, task.extension);
        let (off, along) = self.bones.knee(distance);
        let knee = task.axis * along + side * off;
        let ankle = task.axis * distance;
        let sole = task.foot - task.ankle;
        let mut above = task.above;
        let mut turned = solved;
        for (joint, bone) in [knee, ankle - knee, sole].into_iter().enumerate() {
            let rest = self.offsets[joint + 1].try_normalize();
            if let (Some(rest), Some(bone)) = (rest, (above.inverse() * bone).try_normalize()) {
                let before = before.map(|before| before[joint]);
                turned[joint] = smallest_rotation(rest, bone, before, max_twist);
            }
            above = (above * turned[joint]).normalize();
        }
        turned
    }
}

/// 1 for a foot as low as the lower one, 0 for one well above it, smooth between.
fn weight_carried(above_lower: f64) -> f64 {
    let (full, none) = STANDING;
    let part = ((none - above_lower) / (none - full)).clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}

fn nearer_sign(rotation: DQuat, before: DQuat) -> DQuat {
    if rotation.dot(before) < 0.0 {
        -rotation
    } else {
        rotation
    }
}

fn offset(skeleton: &Skeleton, joint: usize) -> DVec3 {
    Vec3::from_array(skeleton.offsets[joint]).as_dvec3()
}

fn place(pose: ArrayView2<'_, f32>, joint: usize) -> DVec3 {
    let axis = |axis: usize| f64::from(pose[[joint, axis]]);
    DVec3::new(axis(0), axis(1), axis(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{InverseKinematics, forward};

    fn skeleton() -> Skeleton {
        serde_json::from_str(include_str!("../../../tests/fixtures/motion/skeleton.json")).unwrap()
    }

    /// What a decoder says whose legs are `scale(frame)` times the skeleton's while it stands on the
    /// same spot: the joints above the legs come down or go up with it.
    fn scaled_legs(frames: usize, scale: impl Fn(usize) -> f32) -> Positions {
        let rest = forward(
            &skeleton(),
            &Animation {
                fps: 60,
                root: vec![Vec3::new(0.0, 0.96, 0.0)],
                rotations: vec![vec![glam::Quat::IDENTITY; 24]],
            },
        )
        .unwrap();
        let mut positions = Positions::zeros((frames, 24, 3));
        for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
            let scale = scale(frame);
            pose.assign(&rest.index_axis(ndarray::Axis(0), 0));
            for [hip, knee, ankle, foot] in [[1, 4, 7, 10], [2, 5, 8, 11]] {
                for (child, parent) in [(knee, hip), (ankle, knee), (foot, ankle)] {
                    let of = |joint: usize, axis: usize| rest[[0, joint, axis]];
                    let factor = if child == foot { 1.0 } else { scale };
                    for axis in 0..3 {
                        pose[[child, axis]] =
                            pose[[parent, axis]] + factor * (of(child, axis) - of(parent, axis));
                    }
                }
            }
            // Both legs shrink alike, so lifting the pose by the left one's loss puts it back.
            let gone = pose[[10, 1]] - rest[[0, 10, 1]];
            pose.column_mut(1).mapv_inplace(|y| y - gone);
        }
        positions
    }

    fn followed(positions: &Positions) -> (Animation, Positions) {
        let solver = InverseKinematics::new(&skeleton()).unwrap();
        let solved = solver.solve(positions, 60).unwrap();
        let mut following = Legs::new(&skeleton()).start(60);
        let mut animation = following.push(solved, positions);
        animation.append(following.end());
        let posed = forward(&skeleton(), &animation).unwrap();
        (animation, posed)
    }

    fn apart(a: &Positions, b: &Positions, joint: usize) -> f64 {
        let frames = a.outer_iter().zip(b.outer_iter());
        frames
            .map(|(a, b)| (place(a, joint) - place(b, joint)).length())
            .fold(0.0, f64::max)
    }

    #[test]
    fn the_two_legs_are_found_and_other_skeletons_have_none() {
        let legs = Legs::new(&skeleton()).legs;
        let joints: Vec<_> = legs.iter().map(|leg| leg.joints).collect();
        assert_eq!(joints, [[1, 4, 7, 10], [2, 5, 8, 11]]);
        let mut toes = skeleton();
        toes.parents[22] = 7;
        assert_eq!(Legs::new(&toes).legs.len(), 1);
        let two = Skeleton {
            joints: vec!["root".into(), "l_foot".into()],
            parents: vec![-1, 0],
            offsets: vec![[0.0; 3], [0.0, -1.0, 0.0]],
            root_height: 1.0,
        };
        assert!(Legs::new(&two).legs.is_empty());
    }

    #[test]
    fn shrinking_legs_keep_their_feet_and_bend_their_knees_forwards() {
        // Down to two thirds and back within a second.
        let shrinking = scaled_legs(120, |frame| {
            1.0 - 0.167 * (1.0 - (frame as f32 * 0.105).cos())
        });
        let (animation, posed) = followed(&shrinking);
        for joint in [0, 7, 8, 10, 11] {
            assert!(apart(&shrinking, &posed, joint) < 1e-4, "joint {joint}");
        }
        for joint in [4, 5] {
            let path: Vec<_> = posed.outer_iter().map(|pose| place(pose, joint)).collect();
            assert!(path[30].z > path[0].z + 0.2, "the knee goes forwards");
            for pair in path.windows(2) {
                assert!((pair[1] - pair[0]).length() < 0.06);
            }
        }
        for pair in animation.rotations.windows(2) {
            assert!(pair[0].iter().zip(&pair[1]).all(|(a, b)| a.dot(*b) >= 0.0));
        }
    }

    #[test]
    fn legs_that_are_too_short_lower_the_root_slowly() {
        let stretched = scaled_legs(240, |frame| if frame == 120 { 1.04 } else { 1.0 });
        let (animation, posed) = followed(&stretched);
        // The skeleton's leg is 3 cm shorter there.
        let lowered = |frame: usize| stretched[[frame, 0, 1]] - animation.root[frame].y;
        assert!(lowered(120) > 0.015 && lowered(0).abs() < 1e-6);
        for joint in [10, 11] {
            assert!(apart(&stretched, &posed, joint) < 0.02);
        }
        for frame in 1..240 {
            assert!((lowered(frame) - lowered(frame - 1)).abs() < 0.005);
        }
    }

    #[test]
    fn poses_without_any_length_are_finite() {
        let mut positions = scaled_legs(4, |_| 1.0);
        positions.index_axis_mut(ndarray::Axis(0), 1).fill(0.5);
        for joint in [4, 7, 10] {
            positions[[2, joint, 1]] = 3.0;
        }
        let (animation, _) = followed(&positions);
        let all = animation.rotations.iter().flatten();
        assert!(all.clone().all(|q| q.is_finite() && q.is_normalized()));
    }

    #[test]
    fn a_knee_that_is_not_the_decoders_turns_no_faster_than_a_spin() {
        let leg = Legs::new(&skeleton()).legs.remove(0);
        let task = |above: DQuat| Task {
            above,
            hip: DVec3::Y,
            ankle: DVec3::Y * 0.4,
            foot: DVec3::new(0.0, 0.35, 0.1),
            extension: 1.0,
            bend: DVec3::ZERO,
            axis: DVec3::NEG_Y,
            distance: 0.6,
        };
        let ahead = leg.knee_side(&task(DQuat::IDENTITY), None, 0.2);
        assert!(ahead.z > 0.99);
        let half_turn = task(DQuat::from_rotation_y(3.0));
        let next = leg.knee_side(&half_turn, Some(ahead), 0.2);
        assert!((next.angle_between(ahead) - 0.2).abs() < 1e-9);
        // A knee of the decoder's own bend is copied at once.
        let copied = Task {
            bend: DVec3::NEG_Z * leg.bones.knee(0.6).0,
            ..half_turn
        };
        assert!(leg.knee_side(&copied, Some(ahead), 0.2).z < -0.99);
    }
}
