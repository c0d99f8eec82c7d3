//! The sole of a foot: heel, ball and toe tip, as the skeleton's rest offsets place them.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DQuat, DVec3, Quat};

use crate::{fit::twist_about, floor::STANDING_HEIGHT, skeleton::Skeleton, smooth::smooth_step};

/// Distance from the ankle back to the heel's contact, share of that from ankle to ball along the
/// floor. Ankle joints lie a quarter of the foot's length from its back, balls at 70 to 75 %.
const HEEL: f64 = 0.4;
/// Distance from the ball on to the toe tip, share of the same. No joint of the skeleton is there:
/// the toes are the last 25 to 30 % of a foot whose part from ankle to ball is half of it, and so
/// half as long as that part. The end site of a BVH lies there, too.
const TOES: f64 = 0.5;
/// Distance from the middle of the sole to its edge, share of the same.
const EDGE: f64 = 0.35;
/// Largest bend of the toes, radians: 65 degrees.
const MOST_BENT: f64 = 1.134;
/// A foot that slants by up to the first of these (sine) keeps the heights of both ends, and from
/// the second on its direction.
const UPRIGHT: (f64, f64) = (0.7, 0.9);
/// Cosine of the slope up to which a foot is not rolled, and from which on it is flat: about a line
/// that is upright, nothing lifts an edge.
const STEEP: (f64, f64) = (0.2, 0.45);
/// Heights below this are pressed together above the floor, metres.
const SOFT: f64 = 0.01;

/// A foot with its sole: three points, each as thick as the ball joint stands high.
#[derive(Clone, Copy, Debug)]
pub(super) struct Foot {
    /// From the ankle to the ball joint, in the ankle's frame.
    pub(super) ball: DVec3,
    /// From the ankle to the heel, as high as the ball.
    pub(super) heel: DVec3,
    /// From the ball joint to the toe tip, in the rest pose along the floor.
    toes: DVec3,
    /// Unit vector across the sole.
    across: DVec3,
    /// Distance from the middle of the sole to its edge.
    edge: f64,
    /// How far below its bones the skin at the ball comes where toes are bent by a right angle.
    sag: f64,
}

/// Height above the floor of a point of the sole, metres: negative below.
pub(super) fn height(point: DVec3) -> f64 {
    point.y - f64::from(STANDING_HEIGHT)
}

impl Foot {
    /// Finds the sole of the foot whose ball is the joint `ball`; none if it points nowhere.
    pub(super) fn of(skeleton: &Skeleton, ball: usize) -> Option<Self> {
        let ball = skeleton.offset(ball).as_dvec3();
        let ahead = ball.with_y(0.0);
        (ahead.length() > 0.01).then_some(Self {
            ball,
            heel: DVec3::Y * ball.y - ahead * HEEL,
            toes: ahead * TOES,
            across: DVec3::Y.cross(ahead).normalize(),
            edge: EDGE * ahead.length(),
            sag: 0.0,
        })
    }

    /// With toes of this length from the ball joint to their tip, and a skin that comes this far
    /// below the bones where they are bent by a right angle, metres.
    pub(super) fn with_toes(self, length: f64, sag: f64) -> Self {
        Self { toes: self.toes.normalize() * length, sag, ..self }
    }

    /// Returns how far the lowest point of an unbent sole is above the floor, at least 0.
    pub(super) fn clearance(&self, ball: DVec3, turn: DQuat) -> f64 {
        let ends = [self.heel - self.ball, DVec3::ZERO, self.toes];
        ends.map(|end| height(ball + turn * end)).into_iter().fold(f64::INFINITY, f64::min).max(0.0)
    }

    /// Returns the rotation of a foot rolled about `line`, a unit vector, so far that no edge of a
    /// sole with this clearance is below the floor: a foot that stands, stands flat. Joints do not
    /// say how a foot is rolled; it has that from the twist of the leg.
    pub(super) fn levelled(&self, turn: DQuat, line: DVec3, clearance: f64) -> DQuat {
        let most = clearance / self.edge;
        // About the line, `across` rises as across * cos a + up * sin a.
        let [across, up] = [turn * self.across, line.cross(turn * self.across)].map(|v| v.y);
        let wanted = if most > 1e-9 { most * (across / most).tanh() } else { 0.0 };
        if across.abs() - wanted.abs() < 1e-9 {
            return turn;
        }
        let phase = up.atan2(across);
        let slope = across.hypot(up);
        let angle = (wanted / slope).clamp(-1.0, 1.0).acos().copysign(phase);
        let share = smooth_step((slope - STEEP.0) / (STEEP.1 - STEEP.0));
        (DQuat::from_axis_angle(line, (phase - angle) * share) * turn).normalize()
    }

    /// Returns the unit vector from heel to ball that points where `line` points on the floor and
    /// rises as much: both ends keep their heights, whatever the line's length. A foot that stands
    /// upright has no such direction, and takes the line's own.
    pub(super) fn slanted(&self, line: DVec3) -> DVec3 {
        let own = line.normalize_or(DVec3::Z);
        let rise = (line.y / (self.ball - self.heel).length()).clamp(-1.0, 1.0);
        let level = own.with_y(0.0).normalize_or_zero() * (1.0 - rise * rise).sqrt();
        let (kept, upright) = UPRIGHT;
        let share = smooth_step((upright - own.y.abs().max(rise.abs())) / (upright - kept));
        own.lerp(level + DVec3::Y * rise, share).normalize_or(own)
    }

    /// Returns the angle by which the toes of a foot with this world rotation bend up, at least by
    /// `least` and so that their tip stays above the floor, and how far the foot must be lifted
    /// where they cannot.
    pub(super) fn toe_bend(&self, ball: DVec3, turn: DQuat, least: f64) -> (f64, f64) {
        let length = self.toes.length();
        let [ahead, up] = [self.toes / length, DVec3::Y].map(|direction| (turn * direction).y);
        let straight = height(ball) + length * ahead;
        let wanted = above_floor(straight);
        let is_above = wanted - straight < 1e-9;
        if is_above && least <= 0.0 {
            return (0.0, 0.0);
        }
        // length * (ahead cos a + up sin a) = wanted - height(ball)
        let rise = |angle: f64| length * (ahead * angle.cos() + up * angle.sin());
        let (largest, phase) = (ahead.hypot(up).max(1e-9), up.atan2(ahead));
        // Past upright, with the toes pointing back, they bend up still.
        let phase = if phase < -FRAC_PI_2 { phase + TAU } else { phase };
        let share = (wanted - height(ball)) / (length * largest);
        let needed = if is_above { 0.0 } else { phase - share.clamp(-1.0, 1.0).acos() };
        let angle = needed.max(least).clamp(0.0, MOST_BENT);
        let lift = (wanted - height(ball) - rise(angle)).max(0.0);
        // High above the floor a skin may sag.
        let near = smooth_step(1.0 - height(ball) / (4.0 * self.sag).max(1e-9));
        (angle, lift + self.sag * (1.0 - angle.cos()) * near)
    }

    /// Returns the local rotation of the ball joint that bends the toes up by `angle`.
    pub(super) fn toes_bent(&self, angle: f64) -> DQuat {
        DQuat::from_axis_angle(self.toe_axis(), angle)
    }

    /// Returns the axis about which the toes bend up, in the frame of the ball joint.
    fn toe_axis(&self) -> DVec3 {
        self.toes.cross(DVec3::Y).normalize()
    }

    /// Returns the angle by which a local rotation of the ball joint bends the toes up.
    pub(super) fn bend_of(&self, turn: Quat) -> f64 {
        twist_about(self.toe_axis(), turn.as_dquat()).clamp(0.0, MOST_BENT)
    }

    /// Returns the toe tip of a foot.
    #[cfg(test)]
    pub(super) fn toe_tip(&self, ball: DVec3, turn: DQuat, bend: f64) -> DVec3 {
        ball + turn * self.toes_bent(bend) * self.toes
    }
}

/// Returns a height that is nowhere below the floor, and the same from [`SOFT`] on: smooth between,
/// so that a foot that sinks does not stop abruptly.
pub(super) fn above_floor(height: f64) -> f64 {
    match height < SOFT {
        true => SOFT * (height / SOFT - 1.0).exp(),
        false => height,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn toes_lie_on_the_floor_when_the_heel_lifts() {
        let foot = Foot::of(&Skeleton::fixture(), 10).unwrap();
        let ball = DVec3::Y * f64::from(STANDING_HEIGHT);
        let across = foot.toes.cross(DVec3::Y).normalize();
        for lifted in [0.0, 0.2, 0.5, 1.0, 1.3] {
            let turn = DQuat::from_axis_angle(across, -lifted);
            let (bend, lift) = foot.toe_bend(ball, turn, 0.0);
            let tip = foot.toe_tip(ball, turn, bend) + DVec3::Y * lift;
            assert!((height(tip) - above_floor(-foot.toes.length() * lifted.sin())).abs() < 1e-9);
            assert!((0.0..=MOST_BENT).contains(&bend) && (lift < 1e-9 || bend == MOST_BENT));
            assert!(bend > 0.8 * lifted.min(MOST_BENT), "{lifted}: {bend}");
        }
        // Past upright nothing jumps.
        let mut last = None;
        for step in 0..100 {
            let turn = DQuat::from_axis_angle(across, -1.2 - 0.01 * f64::from(step));
            let found = foot.toe_bend(ball, turn, 0.0);
            let near = |(bend, lift): (f64, f64)| {
                (bend - found.0).abs() < 0.02 && (lift - found.1).abs() < 1e-3
            };
            assert!(last.is_none_or(near), "step {step}: {last:?} {found:?}");
            last = Some(found);
        }
        // Toes that point up stay straight.
        let turn = DQuat::from_axis_angle(across, 0.5);
        assert_eq!(foot.toe_bend(ball, turn, 0.0), (0.0, 0.0));
    }

    #[test]
    fn a_foot_is_lifted_by_as_much_as_its_skin_sags_near_the_floor() {
        let foot = Foot::of(&Skeleton::fixture(), 10).unwrap();
        let soft = foot.with_toes(0.07, 0.01);
        let turn = DQuat::from_axis_angle(foot.toes.cross(DVec3::Y).normalize(), -0.9);
        let lift = |foot: &Foot, above: f64| {
            foot.toe_bend(DVec3::Y * (f64::from(STANDING_HEIGHT) + above), turn, 0.0).1
        };
        assert!(lift(&foot, 0.0) < 1e-9);
        assert!((0.002..0.004).contains(&lift(&soft, 0.0)), "{}", lift(&soft, 0.0));
        assert!(lift(&soft, 0.02) < 0.6 * lift(&soft, 0.0) && lift(&soft, 0.05) < 1e-9);
    }

    #[test]
    fn a_foot_that_stands_lies_flat_and_one_in_the_air_rolls() {
        for (ball, side) in [(10, 1.0), (11, -1.0)] {
            let foot = Foot::of(&Skeleton::fixture(), ball).unwrap();
            let edge = foot.edge;
            for roll in [-1.2, -0.6, -0.1, 0.0, 0.3, 0.9] {
                let rolled = DQuat::from_rotation_y(0.4) * DQuat::from_rotation_z(side * roll);
                let mut last = None;
                for lifted in 0..300 {
                    // The ball comes from the floor to 30 cm.
                    let ball = DVec3::Y * (f64::from(STANDING_HEIGHT) + 1e-3 * f64::from(lifted));
                    let line = (rolled * foot.ball).normalize();
                    let turn = foot.levelled(rolled, line, foot.clearance(ball, rolled));
                    assert!((turn * foot.ball).distance(rolled * foot.ball) < 1e-9);
                    let lowest = height(ball) - edge * (turn * foot.across).y.abs();
                    assert!(lowest > -1e-9, "{roll} at {lifted} mm: {lowest}");
                    let turned = last.map_or(0.0, |last: DQuat| last.angle_between(turn));
                    assert!(turned < 0.06, "{roll} at {lifted} mm: {turned}");
                    last = Some(turn);
                }
                assert!(last.unwrap().angle_between(rolled) < 0.1);
            }
        }
    }

    #[test]
    fn a_foot_that_rises_upright_on_its_ball_does_not_spin() {
        let foot = Foot::of(&Skeleton::fixture(), 10).unwrap();
        let ball = DVec3::Y * f64::from(STANDING_HEIGHT);
        for roll in [-0.3, 0.05, 0.3] {
            let mut last = None;
            for step in 0..200 {
                let rise = DQuat::from_axis_angle(foot.across, 0.6 + 0.005 * f64::from(step));
                let turn = DQuat::from_rotation_y(0.4) * rise * DQuat::from_rotation_z(roll);
                let line = (turn * foot.ball).normalize();
                let turn = foot.levelled(turn, line, foot.clearance(ball, turn));
                let turned = last.map_or(0.0, |last: DQuat| last.angle_between(turn));
                assert!(turned < 0.04, "rolled by {roll}, step {step}: {turned}");
                last = Some(turn);
            }
        }
    }

    #[test]
    fn a_line_of_another_length_keeps_its_rise_and_an_upright_one_does_not_jump() {
        let foot = Foot::of(&Skeleton::fixture(), 11).unwrap();
        let length = (foot.ball - foot.heel).length();
        for line in [DVec3::new(0.1, 0.05, 0.1), DVec3::new(0.0, -0.08, 0.3)] {
            let slanted = foot.slanted(line);
            assert!((slanted.length() - 1.0).abs() < 1e-12);
            assert!((slanted.y * length - line.y).abs() < 1e-12);
            assert!(slanted.with_y(0.0).angle_between(line.with_y(0.0)) < 1e-6);
        }
        // From a slope ahead over upright to a slope behind.
        let mut last = None;
        for step in 0..=200 {
            let angle = 0.6 + 0.01 * f64::from(step);
            let line = DVec3::new(0.0, -angle.sin(), angle.cos()) * 1.1 * length;
            let slanted = foot.slanted(line);
            let turned = last.map_or(0.0, |last| slanted.angle_between(last));
            assert!(turned < 0.03, "at {angle}: {turned}");
            last = Some(slanted);
        }
    }

    #[test]
    fn heights_are_pressed_above_the_floor_without_a_kink() {
        let mut last = above_floor(-0.1);
        assert!(last > 0.0);
        for step in 1..300 {
            let now = above_floor(-0.1 + 0.001 * f64::from(step));
            assert!(now >= last && now - last <= 0.001 + 1e-12);
            last = now;
        }
        assert_eq!(above_floor(0.02), 0.02);
    }
}
