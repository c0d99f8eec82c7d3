//! Which bone of a file is which part of the body: found, given, checked, and told.

use std::collections::BTreeMap;

use bailando_motion::{BodyPart, Side};
use serde::{Deserialize, Serialize};

use super::{
    names,
    parts::{Parts, name_of, parts},
    refusal::{problem, short},
    shape,
    tree::Tree,
};
use crate::error::FormatError;

/// How the bones of a rig were recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FoundBy {
    /// The file says so: humanoid bones of VRM.
    Humanoid,
    /// By their names.
    Names,
    /// By hierarchy and rest pose.
    Shape,
    /// The caller said all that is needed.
    Given,
}

/// Names of one bone or, from below, of several.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum BoneNames {
    /// One bone.
    One(String),
    /// Several, of spine or neck; none takes a bone out.
    Several(Vec<String>),
}

/// Which bone of a rig is which part of the body, as it is told and can be given. Parts are
/// `hips`, `spine`, `neck`, `head`, and with `left` and `right` in front `Shoulder`, `UpperArm`,
/// `LowerArm`, `Hand`, `UpperLeg`, `LowerLeg`, `Foot` and `Toes`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigMapping {
    /// How the bones were recognised; needs not be given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found_by: Option<FoundBy>,
    /// Names of bones by part; `#12` is the twelfth bone of the file, counted from 0, for one that
    /// has no name of its own.
    pub bones: BTreeMap<String, BoneNames>,
}

/// Finds the bones of a humanoid: as the file says, by names, by shape; `given` ones win.
pub(super) fn find(
    tree: &Tree,
    humanoid: Option<Parts>,
    given: &RigMapping,
) -> Result<(Parts, FoundBy), FormatError> {
    let given = read(tree, given)?;
    let of_file = humanoid.map(|parts| (parts, FoundBy::Humanoid));
    let by_names = || names::find(tree).map(|parts| (parts, FoundBy::Names));
    let by_shape = || shape::find(tree).map(|parts| (parts, FoundBy::Shape));
    let found = of_file.or_else(by_names).or_else(by_shape);
    let (mut parts, found_by) = match found {
        Some(found) => found,
        None if given.is_empty() => {
            return problem(format!(
                "no humanoid is found among its {} bones, neither by VRM's humanoid bones nor by \
                 names (Mixamo, Unreal, Unity, Rigify, VRoid, Rokoko, SMPL, 3ds Max, MMD) nor by \
                 shape: say in the mapping which bones are hips, leftUpperLeg, leftLowerLeg, \
                 leftFoot, leftUpperArm, leftLowerArm, and the right ones",
                tree.bones.len()
            ));
        }
        None => (Parts::new(), FoundBy::Given),
    };
    for (part, bones) in given {
        match bones.is_empty() {
            true => parts.remove(&part),
            false => parts.insert(part, bones),
        };
    }
    check(tree, &parts)?;
    Ok((parts, found_by))
}

fn read(tree: &Tree, given: &RigMapping) -> Result<Parts, FormatError> {
    let known: BTreeMap<String, BodyPart> = parts().map(|(part, name)| (name, part)).collect();
    let mut read = Parts::new();
    for (name, bones) in &given.bones {
        let Some(&part) = known.get(name) else {
            let all: Vec<String> = parts().map(|(_, name)| name).collect();
            return problem(format!(
                "the mapping has the part `{}`; there are {}",
                short(name),
                all.join(", ")
            ));
        };
        let labels = match bones {
            BoneNames::One(label) => std::slice::from_ref(label),
            BoneNames::Several(labels) => labels.as_slice(),
        };
        let bones: Vec<usize> =
            labels.iter().map(|label| tree.labelled(label)).collect::<Result<_, _>>()?;
        let is_chain = matches!(part, BodyPart::Spine | BodyPart::Neck);
        if bones.len() > 1 && !is_chain {
            return problem(format!("the mapping names {} bones for `{name}`", bones.len()));
        }
        read.insert(part, bones);
    }
    Ok(read)
}

/// Returns a mapping as it is told.
pub(super) fn told(tree: &Tree, parts: &Parts, found_by: FoundBy) -> RigMapping {
    let bones = parts.iter().filter_map(|(&part, bones)| {
        let mut labels: Vec<String> = bones.iter().map(|&bone| tree.label(bone)).collect();
        let names = match labels.len() {
            0 => return None,
            1 => BoneNames::One(labels.remove(0)),
            _ => BoneNames::Several(labels),
        };
        Some((name_of(part), names))
    });
    RigMapping { found_by: Some(found_by), bones: bones.collect() }
}

/// Checks that the parts that are needed are there and hang together.
fn check(tree: &Tree, parts: &Parts) -> Result<(), FormatError> {
    let bone = |part| parts.get(&part).and_then(|bones| bones.first().copied());
    let Some(hips) = bone(BodyPart::Hips) else {
        return problem("it has no bone for `hips`");
    };
    for side in Side::BOTH {
        let needed = [
            BodyPart::UpperLeg(side),
            BodyPart::LowerLeg(side),
            BodyPart::Foot(side),
            BodyPart::UpperArm(side),
            BodyPart::LowerArm(side),
        ];
        if let Some(missing) = needed.into_iter().find(|&part| bone(part).is_none()) {
            return problem(format!("it has no bone for `{}`", name_of(missing)));
        }
        let legs = [needed[0], needed[1], needed[2], BodyPart::Toes(side)];
        let arms = [BodyPart::Shoulder(side), needed[3], needed[4], BodyPart::Hand(side)];
        for chain in [legs, arms] {
            let mut above = (BodyPart::Hips, hips);
            for part in chain {
                let Some(bone) = bone(part) else { continue };
                hangs_on(tree, above, (part, bone))?;
                above = (part, bone);
            }
        }
    }
    let trunk = [BodyPart::Spine, BodyPart::Neck, BodyPart::Head];
    let trunk = trunk.iter().flat_map(|part| parts.get(part).map(|bones| (*part, bones)));
    let mut above = (BodyPart::Hips, hips);
    for (part, bones) in trunk {
        for &bone in bones {
            hangs_on(tree, above, (part, bone))?;
            above = (part, bone);
        }
    }
    Ok(())
}

fn hangs_on(
    tree: &Tree,
    (part_above, above): (BodyPart, usize),
    (part, bone): (BodyPart, usize),
) -> Result<(), FormatError> {
    if tree.is_above(above, bone) {
        return Ok(());
    }
    problem(format!(
        "`{}` ({}) does not hang on `{}` ({}): say in the mapping which bones are meant",
        tree.shown(bone),
        name_of(part),
        tree.shown(above),
        name_of(part_above)
    ))
}
