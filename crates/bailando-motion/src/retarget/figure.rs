//! A figure to dance with: the bones of a humanoid in their rest pose.

use glam::DVec3;

/// A side of the body, its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// Left.
    Left,
    /// Right.
    Right,
}

impl Side {
    /// Both, the left one first.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

/// A part of the body that a bone turns, from the bone's joint on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BodyPart {
    /// The bone above legs and spine, which carries the path of the dance.
    Hips,
    /// One of any number of bones between hips and shoulders.
    Spine,
    /// One of any number of bones between shoulders and head.
    Neck,
    /// The head.
    Head,
    /// The collar bone.
    Shoulder(Side),
    /// From the shoulder's joint to the elbow.
    UpperArm(Side),
    /// From the elbow to the wrist.
    LowerArm(Side),
    /// From the wrist on.
    Hand(Side),
    /// From the hip's joint to the knee.
    UpperLeg(Side),
    /// From the knee to the ankle.
    LowerLeg(Side),
    /// From the ankle on.
    Foot(Side),
    /// From the ball of the foot on.
    Toes(Side),
}

/// A bone of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FigureBone {
    /// What it turns.
    pub part: BodyPart,
    /// Where its joint rests, in the figure's unit and axes.
    pub place: DVec3,
}

/// A humanoid in its rest pose (T, A, or the like), in any unit and with any axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Bones, those of spine and neck from below. Legs to the feet are needed, and upper arms or a
    /// head, which say where up is; all others may be missing.
    pub bones: Vec<FigureBone>,
    /// Ends of everything that hangs on the feet, left and right: they show where the sole is.
    pub feet: [Vec<DVec3>; 2],
    /// Whether the figure stands on the plane through the origin, as in glTF; it is believed where
    /// the feet do not contradict.
    pub stands_on_origin: bool,
}

impl Figure {
    /// Returns where a part's first bone rests.
    pub(super) fn place(&self, part: BodyPart) -> Option<DVec3> {
        self.bones.iter().find(|bone| bone.part == part).map(|bone| bone.place)
    }
}
