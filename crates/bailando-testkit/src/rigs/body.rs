//! A humanoid at rest: parts, their joints in metres, and their axes.

use glam::{DQuat, DVec3};

/// A bone of a body.
#[derive(Clone, Debug)]
pub struct RigBone {
    /// What it is, by a name of ours: `l_upper_leg`.
    pub part: String,
    /// What the file calls it.
    pub name: String,
    /// The bone it hangs on, one before it.
    pub parent: Option<usize>,
    /// Where its joint rests, metres, the sole at 0.
    pub place: DVec3,
    /// Its axes at rest.
    pub axes: DQuat,
}

/// A body at rest.
#[derive(Clone, Debug)]
pub struct Body {
    /// Bones, a parent before its children.
    pub bones: Vec<RigBone>,
}

/// Joints of the middle and the left of a person of 1 m: part, parent, and place.
const JOINTS: [(&str, &str, [f64; 3]); 17] = [
    ("hips", "", [0.0, 0.53, 0.0]),
    ("spine", "hips", [0.0, 0.585, 0.0]),
    ("chest", "spine", [0.0, 0.66, -0.01]),
    ("upper_chest", "chest", [0.0, 0.74, -0.012]),
    ("neck", "upper_chest", [0.0, 0.84, -0.005]),
    ("head", "neck", [0.0, 0.89, 0.008]),
    ("head_end", "head", [0.0, 1.0, 0.01]),
    ("l_shoulder", "upper_chest", [0.025, 0.815, 0.0]),
    ("l_upper_arm", "l_shoulder", [0.105, 0.815, -0.01]),
    ("l_lower_arm", "l_upper_arm", [0.27, 0.815, -0.012]),
    ("l_hand", "l_lower_arm", [0.42, 0.815, -0.005]),
    ("l_finger", "l_hand", [0.47, 0.812, 0.0]),
    ("l_upper_leg", "hips", [0.053, 0.505, 0.0]),
    ("l_lower_leg", "l_upper_leg", [0.056, 0.28, 0.006]),
    ("l_foot", "l_lower_leg", [0.056, 0.046, -0.012]),
    ("l_toes", "l_foot", [0.062, 0.012, 0.068]),
    ("l_toe_end", "l_toes", [0.065, 0.012, 0.105]),
];

impl Body {
    /// Makes a body of `height` metres that faces +z, whose legs are `legs` times as long as
    /// customary and whose arms hang `arms` radians below the horizontal.
    pub fn new(height: f64, legs: f64, arms: f64) -> Self {
        let saved = 0.505 * (1.0 - legs);
        let stature = height / (1.0 - saved);
        let mut bones: Vec<RigBone> = Vec::new();
        for mirrored in [false, true] {
            for (part, parent, place) in JOINTS {
                let is_left = part.starts_with("l_");
                if mirrored && !is_left {
                    continue;
                }
                let mut place = DVec3::from(place);
                let arm = ["lower_arm", "hand", "finger"].iter().any(|end| part.ends_with(end));
                if arm {
                    let shoulder = DVec3::new(0.105, 0.815, -0.01);
                    place = shoulder + DQuat::from_rotation_z(-arms) * (place - shoulder);
                }
                let is_leg =
                    ["leg", "foot", "toes", "toe_end"].iter().any(|end| part.ends_with(end));
                place.y = if is_leg { place.y * legs } else { place.y - saved };
                let side = |name: &str| match (name.strip_prefix("l_"), mirrored) {
                    (Some(rest), true) => format!("r_{rest}"),
                    _ => name.to_owned(),
                };
                if mirrored {
                    place.x = -place.x;
                }
                let parent = side(parent);
                let parent = bones.iter().position(|bone: &RigBone| bone.part == parent);
                let (part, name) = (side(part), side(part));
                let (place, axes) = (place * stature, DQuat::IDENTITY);
                bones.push(RigBone { part, name, parent, place, axes });
            }
        }
        Self { bones }
    }

    /// Raises the balls of the feet and doubles the toes, as those of figures with thick soles.
    pub fn lengthen_toes(&mut self) {
        for side in ["l", "r"] {
            let [ball, end] = ["toes", "toe_end"].map(|part| self.index(&format!("{side}_{part}")));
            let toes = self.bones[end].place - self.bones[ball].place;
            self.bones[end].place += toes;
            self.bones[ball].place.y *= 2.5;
        }
    }

    fn index(&self, part: &str) -> usize {
        let found = self.bones.iter().position(|bone| bone.part == part);
        found.unwrap_or_else(|| panic!("no {part}"))
    }

    /// Returns a part's bone.
    pub fn bone(&self, part: &str) -> &RigBone {
        &self.bones[self.index(part)]
    }

    /// Returns what the file calls a part.
    pub fn name(&self, part: &str) -> String {
        self.bone(part).name.clone()
    }

    /// Gives parts other names.
    pub fn rename(&mut self, names: &[(&str, &str)]) {
        for (part, name) in names {
            let at = self.index(part);
            self.bones[at].name = (*name).to_owned();
        }
    }

    /// Gives parts of both sides other names, with the side in front, or `l` and `r` behind after a
    /// separator.
    pub fn rename_sides(&mut self, sides: [&str; 2], separator: &str, names: &[(&str, &str)]) {
        for (side, front) in ["l", "r"].into_iter().zip(sides) {
            for (part, name) in names {
                let at = self.index(&format!("{side}_{part}"));
                let end = if separator.is_empty() { "" } else { side };
                self.bones[at].name = format!("{front}{name}{separator}{end}");
            }
        }
    }

    /// Gives every bone the name that `name` makes of its part.
    pub fn rename_all(&mut self, mut name: impl FnMut(&str) -> String) {
        for bone in &mut self.bones {
            bone.name = name(&bone.part);
        }
    }

    /// Puts a bone of this name half of the way above a part.
    pub fn split(&mut self, part: &str, new: &str) {
        let at = self.index(part);
        let parent = self.bones[at].parent;
        let above = parent.map_or(DVec3::ZERO, |parent| self.bones[parent].place);
        let place = above.lerp(self.bones[at].place, 0.5);
        for bone in &mut self.bones {
            bone.parent = bone.parent.map(|parent| if parent >= at { parent + 1 } else { parent });
        }
        let (part, name, axes) = (new.to_owned(), new.to_owned(), DQuat::IDENTITY);
        self.bones.insert(at, RigBone { part, name, parent, place, axes });
        self.bones[at + 1].parent = Some(at);
    }

    /// Hangs one more bone on a part.
    pub fn hang(&mut self, part: &str, on: &str, offset: DVec3) {
        let parent = self.index(on);
        let place = self.bones[parent].place + offset;
        let (part, name, axes) = (part.to_owned(), part.to_owned(), DQuat::IDENTITY);
        self.bones.push(RigBone { part, name, parent: Some(parent), place, axes });
    }

    /// Hangs five fingers of three bones, but for the first bone that there is, on a hand.
    pub fn fingers(&mut self, side: &str) {
        let out = if side == "l" { 1.0 } else { -1.0 };
        for (number, finger) in ["thumb", "index", "middle", "ring", "little"].iter().enumerate() {
            let mut on = format!("{side}_hand");
            for joint in if number == 1 { 1..=2 } else { 1..=3 } {
                let part = format!("{side}_{finger}{joint}");
                let start = if on.ends_with("hand") { 0.06 } else { 0.025 };
                let across = 0.02 * number as f64 - 0.04;
                let across = if on.ends_with("hand") { across } else { 0.0 };
                self.hang(&part, &on, DVec3::new(out * start, 0.0, -across));
                on = part;
            }
        }
    }

    /// Turns the whole body about the origin.
    pub fn turn(&mut self, turn: DQuat) {
        for bone in &mut self.bones {
            bone.place = turn * bone.place;
        }
    }

    /// Points one axis of every bone along it; on the right against it.
    pub fn point_axes(&mut self, axis: DVec3) {
        for at in 0..self.bones.len() {
            let child = self.bones.iter().position(|bone| bone.parent == Some(at));
            let bone = &self.bones[at];
            let along = match (child, bone.parent) {
                (Some(child), _) => self.bones[child].place - bone.place,
                (None, Some(parent)) => bone.place - self.bones[parent].place,
                (None, None) => axis,
            };
            let sign = if bone.part.starts_with("r_") { -1.0 } else { 1.0 };
            let along = along.try_normalize().unwrap_or(axis) * sign;
            self.bones[at].axes = DQuat::from_rotation_arc(axis, along);
        }
    }
}
