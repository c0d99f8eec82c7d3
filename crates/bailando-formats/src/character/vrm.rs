//! The humanoid bones of VRM 0.x and 1.0.

use std::{collections::BTreeMap, fmt};

use bailando_motion::{BodyPart, Side};
use serde::{
    Deserialize, Deserializer,
    de::{Error, MapAccess, Visitor},
};
use serde_json::value::RawValue;

use super::{
    parts::{PAIRED, Parts},
    refusal::{problem, short},
    splice,
    tree::Tree,
};
use crate::error::FormatError;

/// Most humanoid bones that are looked at; VRM knows 55.
const HUMANOID: usize = 256;

/// The extensions that make a GLB an avatar.
#[derive(Clone, Copy, Default, Deserialize)]
pub(super) struct Extensions<'a> {
    #[serde(borrow, rename = "VRM")]
    vrm0: Option<&'a RawValue>,
    #[serde(borrow, rename = "VRMC_vrm")]
    vrm1: Option<&'a RawValue>,
}

#[derive(Deserialize)]
struct Vrm0<'a> {
    #[serde(borrow)]
    humanoid: Option<Humanoid0<'a>>,
}
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Humanoid0<'a> {
    #[serde(borrow)]
    human_bones: Option<&'a RawValue>,
}
#[derive(Deserialize)]
struct Bone0 {
    bone: String,
    node: i64,
}
#[derive(Deserialize)]
struct Vrm1 {
    humanoid: Option<Humanoid1>,
}
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Humanoid1 {
    #[serde(default, deserialize_with = "named_nodes")]
    human_bones: BTreeMap<String, i64>,
}
#[derive(Deserialize)]
struct Bone1 {
    node: i64,
}

/// Reads nodes by the names of their bones, not too many.
fn named_nodes<'a, D: Deserializer<'a>>(from: D) -> Result<BTreeMap<String, i64>, D::Error> {
    struct AtMost;

    impl<'a> Visitor<'a> for AtMost {
        type Value = BTreeMap<String, i64>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "at most {HUMANOID} humanoid bones")
        }

        fn visit_map<A: MapAccess<'a>>(self, mut bones: A) -> Result<Self::Value, A::Error> {
            let mut nodes = BTreeMap::new();
            while let Some(name) = bones.next_key::<String>()? {
                if nodes.len() == HUMANOID {
                    return Err(A::Error::custom(format!("more than {HUMANOID} humanoid bones")));
                }
                nodes.insert(name, bones.next_value::<Bone1>()?.node);
            }
            Ok(nodes)
        }
    }

    from.deserialize_map(AtMost)
}

impl Extensions<'_> {
    /// Whether the file is an avatar.
    pub(super) fn is_vrm(&self) -> bool {
        self.vrm0.is_some() || self.vrm1.is_some()
    }

    /// Reads the humanoid bones of VRM 0.x or 1.0.
    pub(super) fn humanoid(&self, tree: &Tree) -> Result<Option<Parts>, FormatError> {
        let named: BTreeMap<String, i64> = if let Some(vrm) = self.vrm1 {
            let vrm: Vrm1 = serde_json::from_str(vrm.get()).or_else(|error| {
                problem(format!("its VRMC_vrm extension: {}", short(&error.to_string())))
            })?;
            vrm.humanoid.map(|humanoid| humanoid.human_bones).unwrap_or_default()
        } else if let Some(vrm) = self.vrm0 {
            let vrm: Vrm0<'_> = serde_json::from_str(vrm.get()).or_else(|error| {
                problem(format!("its VRM extension: {}", short(&error.to_string())))
            })?;
            let bones = vrm.humanoid.and_then(|humanoid| humanoid.human_bones);
            let bones: Vec<Bone0> = splice::array("humanBones", bones, HUMANOID)?;
            bones.into_iter().map(|bone| (bone.bone, bone.node)).collect()
        } else {
            return Ok(None);
        };
        let mut parts = Parts::new();
        let mut put = |part: BodyPart, name: &str| {
            // UniVRM writes -1 for a bone that there is not.
            let Some(&node) = named.get(name).filter(|&&node| node >= 0) else { return Ok(()) };
            match usize::try_from(node).ok().filter(|&node| node < tree.bones.len()) {
                Some(node) => {
                    parts.entry(part).or_default().push(node);
                    Ok(())
                }
                None => {
                    problem(format!("its humanoid bone `{name}` is node {node}, which is none"))
                }
            }
        };
        for (part, name) in [
            (BodyPart::Hips, "hips"),
            (BodyPart::Spine, "spine"),
            (BodyPart::Spine, "chest"),
            (BodyPart::Spine, "upperChest"),
            (BodyPart::Neck, "neck"),
            (BodyPart::Head, "head"),
        ] {
            put(part, name)?;
        }
        for (side, prefix) in [(Side::Left, "left"), (Side::Right, "right")] {
            for (part, name) in PAIRED {
                put(part(side), &format!("{prefix}{name}"))?;
            }
        }
        Ok((!parts.is_empty()).then_some(parts))
    }
}
