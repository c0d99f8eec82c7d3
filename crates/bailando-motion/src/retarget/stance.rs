//! How a figure stands in its file: its axes, its floor and its size.

use glam::{DMat3, DQuat, DVec3};

use super::figure::{BodyPart, Figure, Side};
use crate::{error::MotionError, floor::STANDING_HEIGHT, two_bones::perpendicular};

/// Axes of files are kept exactly where a figure's are as near as this, cosines: 25 degrees for
/// up, 12 for ahead.
const NEAR: [f64; 2] = [0.906, 0.978];
/// The sole of a figure that stands on the origin is this near to it, share of a leg.
const ON_ORIGIN: f64 = 0.2;

/// From the frame of dances (metres, y up, heading for +z, the floor at 0) to that of a file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stance {
    axes: DQuat,
    /// The place on the floor below the hips.
    origin: DVec3,
    /// Units of the file in a metre of the dancer, whose legs are as long as the figure's then.
    unit: f64,
}

/// Rest places of a leg.
#[derive(Clone, Copy, Debug)]
pub(super) struct LegRest {
    pub(super) hip: DVec3,
    pub(super) knee: DVec3,
    pub(super) ankle: DVec3,
    /// The ball of the foot, or the tip of one without toes.
    pub(super) ball: Option<DVec3>,
    /// The end of the toes, where the foot has any and shows it.
    pub(super) tip: Option<DVec3>,
    pub(super) has_toes: bool,
}

impl LegRest {
    fn of(figure: &Figure, side: Side) -> Result<Self, MotionError> {
        let hip = needed(figure, BodyPart::UpperLeg(side))?;
        let ankle = needed(figure, BodyPart::Foot(side))?;
        let toes = figure.place(BodyPart::Toes(side));
        let ends = &figure.feet[side as usize];
        let further = |a: &&DVec3, b: &&DVec3| a.distance(ankle).total_cmp(&b.distance(ankle));
        let leg = Self {
            hip,
            knee: needed(figure, BodyPart::LowerLeg(side))?,
            ankle,
            ball: toes.or_else(|| ends.iter().max_by(further).copied()),
            tip: toes.and_then(|_| ends.iter().max_by(further).copied()),
            has_toes: toes.is_some(),
        };
        let [thigh, shank] = [leg.hip.distance(leg.knee), leg.knee.distance(leg.ankle)];
        if thigh.min(shank) <= 0.05 * thigh.max(shank) {
            return problem(format!(
                "thigh and shank of the {} leg are {thigh:.3} and {shank:.3} long",
                format!("{side:?}").to_lowercase()
            ));
        }
        Ok(leg)
    }

    fn length(&self) -> f64 {
        self.hip.distance(self.knee) + self.knee.distance(self.ankle)
    }
}

fn problem<T>(message: String) -> Result<T, MotionError> {
    Err(MotionError::Figure(message))
}

fn needed(figure: &Figure, part: BodyPart) -> Result<DVec3, MotionError> {
    figure.place(part).ok_or_else(|| MotionError::Figure(format!("it has no {part:?}")))
}

impl Stance {
    /// Measures a figure whose legs and feet become those of a dancer with legs of `dancer` metres
    /// from hip to floor. The legs are returned in the frame of dances.
    pub(super) fn of(figure: &Figure, dancer: f64) -> Result<(Self, [LegRest; 2]), MotionError> {
        let hips = needed(figure, BodyPart::Hips)?;
        if figure.bones.iter().any(|bone| !bone.place.is_finite()) {
            return problem("a bone rests nowhere (NaN or infinity)".into());
        }
        let [left, right] = Side::BOTH.map(|side| LegRest::of(figure, side));
        let legs = [left?, right?];
        let axes = axes(figure, legs)?;
        let into = |place: DVec3| axes.inverse() * place;
        let length = 0.5 * (legs[0].length() + legs[1].length());
        let floor = floor(figure, legs, length, &into);
        let heights = legs.map(|leg| into(leg.ankle).y - floor);
        let unit = (length + 0.5 * (heights[0] + heights[1])) / dancer;
        if !(unit.is_finite() && unit > 1e-9) {
            return problem(format!("its legs are {length} long"));
        }
        let origin = axes * into(hips).with_y(floor);
        let stance = Self { axes, origin, unit };
        Ok((stance, legs.map(|leg| stance.leg_into(leg))))
    }

    fn leg_into(&self, leg: LegRest) -> LegRest {
        let [hip, knee, ankle] = [leg.hip, leg.knee, leg.ankle].map(|place| self.into_dance(place));
        let [ball, tip] = [leg.ball, leg.tip].map(|end| end.map(|end| self.into_dance(end)));
        LegRest { hip, knee, ankle, ball, tip, ..leg }
    }

    /// Returns a place of the file in the frame of dances.
    pub(super) fn into_dance(self, place: DVec3) -> DVec3 {
        self.axes.inverse() * (place - self.origin) / self.unit
    }

    /// Returns a place of the dance in the file.
    pub(super) fn place(&self, place: DVec3) -> DVec3 {
        self.origin + self.axes * place * self.unit
    }

    /// Returns a turn of the dance about the file's axes.
    pub(super) fn turn(&self, turn: DQuat) -> DQuat {
        (self.axes * turn * self.axes.inverse()).normalize()
    }
}

/// Returns the rotation from dances' axes to the figure's: up is from feet to arms and head, its
/// left is where its left limbs are.
fn axes(figure: &Figure, legs: [LegRest; 2]) -> Result<DQuat, MotionError> {
    let arms = Side::BOTH.map(|side| figure.place(BodyPart::UpperArm(side)));
    let [arm_left, arm_right] = arms;
    let top = match (arms, figure.place(BodyPart::Head)) {
        ([Some(left), Some(right)], _) => 0.5 * (left + right),
        (_, Some(head)) => head,
        _ => return problem("it has neither arms nor a head".into()),
    };
    let feet = 0.5 * (legs[0].ankle + legs[1].ankle);
    let across = arm_left.zip(arm_right).map_or(DVec3::ZERO, |(left, right)| left - right);
    let left = legs[0].hip - legs[1].hip + across;
    let Some(up) = (top - feet).try_normalize() else {
        return problem("its shoulders rest where its feet do".into());
    };
    let up = snapped(up, NEAR[0]);
    let Some(left) = perpendicular(left, up).try_normalize() else {
        return problem("its left hip and arm rest where the right ones do".into());
    };
    let left = snapped(left, NEAR[1]);
    let left = perpendicular(left, up).normalize_or(left);
    Ok(DQuat::from_mat3(&DMat3::from_cols(left, up, left.cross(up))).normalize())
}

/// Returns the axis of the file that is as near as `near`, else the direction itself.
fn snapped(direction: DVec3, near: f64) -> DVec3 {
    let axis = direction.abs().max_position();
    let mut snapped = DVec3::ZERO;
    snapped[axis] = direction[axis].signum();
    if snapped.dot(direction) >= near { snapped } else { direction }
}

/// Returns the height of the floor in the figure's unit.
fn floor(figure: &Figure, legs: [LegRest; 2], length: f64, into: &dyn Fn(DVec3) -> DVec3) -> f64 {
    let lowest = |places: &mut dyn Iterator<Item = DVec3>| {
        places.map(|place| into(place).y).fold(f64::INFINITY, f64::min)
    };
    let ankles = lowest(&mut legs.iter().map(|leg| leg.ankle));
    let balls = lowest(&mut legs.iter().filter_map(|leg| leg.ball));
    let ends = lowest(&mut figure.feet.iter().flatten().copied());
    let lowest = ankles.min(balls).min(ends);
    if figure.stands_on_origin && (-0.01 * length..ON_ORIGIN * length).contains(&lowest) {
        return 0.0;
    }
    // A joint is inside of the foot; dancers' balls stand so high with legs of 0.85 m.
    let sole = f64::from(STANDING_HEIGHT) / 0.85 * length;
    match (ends < balls, balls < ankles) {
        (true, _) => ends,
        (false, true) => balls - sole,
        (false, false) => lowest - 4.0 * sole,
    }
}
