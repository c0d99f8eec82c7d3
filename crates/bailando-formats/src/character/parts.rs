//! The parts of a body, their names, and which bones they are.

use std::collections::BTreeMap;

use bailando_motion::{BodyPart, Side};

use super::tree::Tree;

/// Bones by part, those of spine and neck from below.
pub(super) type Parts = BTreeMap<BodyPart, Vec<usize>>;

const CENTRE: [(BodyPart, &str); 4] = [
    (BodyPart::Hips, "hips"),
    (BodyPart::Spine, "spine"),
    (BodyPart::Neck, "neck"),
    (BodyPart::Head, "head"),
];

type OfSide = fn(Side) -> BodyPart;

/// Parts that there are on both sides; each arm and each leg from its root.
pub(super) const PAIRED: [(OfSide, &str); 8] = [
    (BodyPart::Shoulder, "Shoulder"),
    (BodyPart::UpperArm, "UpperArm"),
    (BodyPart::LowerArm, "LowerArm"),
    (BodyPart::Hand, "Hand"),
    (BodyPart::UpperLeg, "UpperLeg"),
    (BodyPart::LowerLeg, "LowerLeg"),
    (BodyPart::Foot, "Foot"),
    (BodyPart::Toes, "Toes"),
];

/// Returns all parts with their names.
pub(super) fn parts() -> impl Iterator<Item = (BodyPart, String)> {
    let side = |side: Side| match side {
        Side::Left => "left",
        Side::Right => "right",
    };
    let paired = Side::BOTH.into_iter().flat_map(move |at| {
        PAIRED.iter().map(move |(part, name)| (part(at), format!("{}{name}", side(at))))
    });
    CENTRE.iter().map(|&(part, name)| (part, name.to_owned())).chain(paired)
}

/// Returns the name of a part.
pub(super) fn name_of(part: BodyPart) -> String {
    parts().find(|&(other, _)| other == part).map(|(_, name)| name).unwrap_or_default()
}

/// Completes limbs to a whole body: hips, spine and neck are what lies between them.
pub(super) fn with_trunk(
    tree: &Tree,
    mut parts: Parts,
    hips: impl Fn(&Tree, &[usize]) -> Option<usize>,
) -> Option<Parts> {
    let both = |part: OfSide| Side::BOTH.map(|side| parts.get(&part(side)).map(|bones| bones[0]));
    let ([Some(left_leg), Some(right_leg)], [Some(left_arm), Some(right_arm)]) =
        (both(BodyPart::UpperLeg), both(BodyPart::UpperArm))
    else {
        return None;
    };
    let hips = hips(tree, &[left_leg, right_leg, left_arm, right_arm])?;
    let chest = tree.common(&[left_arm, right_arm])?;
    let mut spine = Vec::new();
    if chest != hips && tree.is_above(hips, chest) {
        spine = tree.between(hips, chest);
        spine.push(chest);
    }
    let head = parts.get(&BodyPart::Head).map(|bones| bones[0]);
    let neck = match head {
        Some(head) if tree.is_above(chest, head) => tree.between(chest, head),
        _ => Vec::new(),
    };
    parts.insert(BodyPart::Hips, vec![hips]);
    for (part, bones) in [(BodyPart::Spine, spine), (BodyPart::Neck, neck)] {
        if !bones.is_empty() {
            parts.insert(part, bones);
        }
    }
    Some(parts)
}
