//! Bones by their names, as programs and makers of characters give them.

use bailando_motion::{BodyPart, Side};

use super::{
    parts::{PAIRED, Parts, with_trunk},
    tree::Tree,
};

/// Bones of one name that are looked at.
const CANDIDATES: usize = 8;

/// Names of the parts in one tradition: of hips and head, and of the paired parts in the order of
/// [`PAIRED`]. A bone's name ends with one of them; the longest that fits is meant.
struct Tradition {
    hips: &'static [&'static str],
    head: &'static [&'static str],
    paired: [&'static [&'static str]; PAIRED.len()],
}

/// Bones named after limbs (Mixamo, Unreal, Unity, Rigify, VRoid, Rokoko, Xsens, 3ds Max's Biped,
/// Daz, Poser), bones named after joints (SMPL, the first BVH files, Kinect), and MMD's.
const TRADITIONS: [Tradition; 3] = [
    Tradition {
        hips: &["hips", "pelvis", "hip"],
        head: &["head"],
        paired: [
            &["shoulder", "clavicle", "collar", "collarbone"],
            &["upperarm", "uparm", "arm", "shldr", "shldrbend", "armupper", "bicep"],
            &["lowerarm", "forearm", "forearmbend", "lowarm", "armlower", "elbow"],
            &["hand", "wrist"],
            &["upperleg", "upleg", "thigh", "thighbend", "legupper"],
            &["lowerleg", "leg", "shin", "calf", "lowleg", "leglower", "knee"],
            &["foot", "ankle"],
            &["toes", "toebase", "toe", "toe0", "ball"],
        ],
    },
    Tradition {
        hips: &["pelvis", "hips", "hip", "spinebase", "root"],
        head: &["head"],
        paired: [
            &["collar", "clavicle", "innershoulder"],
            &["shoulder"],
            &["elbow"],
            &["wrist"],
            &["hip"],
            &["knee"],
            &["ankle"],
            &["foot", "toe", "toes", "toebase"],
        ],
    },
    Tradition {
        hips: &["腰", "センター", "下半身"],
        head: &["頭"],
        paired: [
            &["肩"],
            &["腕"],
            &["ひじ", "肘"],
            &["手首"],
            &["足"],
            &["ひざ", "膝"],
            &["足首"],
            &["つま先"],
        ],
    },
];

/// Words of bones that help others and are none themselves.
const HELPERS: [&str; 18] = [
    "ik", "fk", "target", "pole", "ctrl", "control", "twist", "roll", "helper", "end", "nub",
    "mch", "org", "tweak", "socket", "mesh", "geo", "vis",
];

/// What a name says: its words in one, without side, and the side.
#[derive(Debug, PartialEq)]
struct Words {
    joined: String,
    side: Option<Side>,
}

impl Words {
    /// Reads a name; none if it is that of a helper.
    fn of(name: &str) -> Option<Self> {
        let name = name.rsplit([':', '|']).next().unwrap_or(name);
        let mut side = None;
        let mut joined = String::new();
        for word in words(name) {
            let found = match word.as_str() {
                "l" | "left" | "左" => Some(Side::Left),
                "r" | "right" | "右" => Some(Side::Right),
                word if HELPERS.contains(&word) => return None,
                _ => None,
            };
            match found {
                Some(_) if side.is_none() => side = found,
                _ => joined.push_str(&word),
            }
        }
        for (prefix, of) in
            [("left", Side::Left), ("right", Side::Right), ("左", Side::Left), ("右", Side::Right)]
        {
            if side.is_none()
                && let Some(rest) = joined.strip_prefix(prefix)
            {
                (side, joined) = (Some(of), rest.to_owned());
            }
        }
        // Of limbs in several pieces (MakeHuman), the first.
        if joined.ends_with("01") {
            joined.truncate(joined.len() - 2);
        }
        Some(Self { joined, side })
    }
}

/// Splits a name at signs and where capitals begin words, in small letters.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let letters: Vec<char> = name.chars().collect();
    for (index, &letter) in letters.iter().enumerate() {
        let before = index.checked_sub(1).map(|before| letters[before]);
        let next = letters.get(index + 1);
        let begins = letter.is_uppercase()
            && before.is_some_and(|before| {
                before.is_lowercase()
                    || before.is_numeric()
                    || before.is_uppercase() && next.is_some_and(|next| next.is_lowercase())
            });
        if begins || !letter.is_alphanumeric() {
            words.push(String::new());
        }
        if letter.is_alphanumeric()
            && let Some(word) = words.last_mut()
        {
            word.extend(letter.to_lowercase());
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Finds a humanoid by names.
pub(super) fn find(tree: &Tree) -> Option<Parts> {
    let named: Vec<(usize, Words)> = tree
        .order
        .iter()
        .filter(|&&bone| tree.bones[bone].turns)
        .filter_map(|&bone| Some((bone, Words::of(&tree.bones[bone].name)?)))
        .collect();
    let found = TRADITIONS.iter().filter_map(|tradition| tradition.find(tree, &named));
    // Of equals the first, which is how most bones are named.
    found.reduce(|best, other| if other.len() > best.len() { other } else { best })
}

impl Tradition {
    fn find(&self, tree: &Tree, named: &[(usize, Words)]) -> Option<Parts> {
        let mut parts = Parts::new();
        for side in Side::BOTH {
            let candidates: Vec<Vec<usize>> = (0..PAIRED.len())
                .map(|part| self.candidates(named, Some(side), Some(part)))
                .collect();
            for (from, needed) in [(4, 3), (1, 2)] {
                let chain = first_chain(tree, &candidates[from..from + needed])?;
                let last = chain[needed - 1];
                for (place, &bone) in chain.iter().enumerate() {
                    parts.insert(PAIRED[from + place].0(side), vec![bone]);
                }
                let ends = from + needed;
                let end = candidates[ends].iter().find(|&&bone| tree.is_above(last, bone));
                if let Some(&end) = end {
                    parts.insert(PAIRED[ends].0(side), vec![end]);
                }
                if from == 1 {
                    let mut shoulders = candidates[0].iter();
                    if let Some(&above) = shoulders.find(|&&bone| tree.is_above(bone, chain[0])) {
                        parts.insert(PAIRED[0].0(side), vec![above]);
                    }
                }
            }
        }
        let hips = self.candidates(named, None, None);
        let mut parts = with_trunk(tree, self.with_head(tree, parts, named), |tree, limbs| {
            let above = |&&bone: &&usize| limbs.iter().all(|&limb| tree.is_above(bone, limb));
            hips.iter().find(above).copied().or_else(|| tree.common(limbs))
        })?;
        // Another character beside this one may have bones of the same names.
        let hips = parts[&BodyPart::Hips][0];
        parts.retain(|_, bones| bones[0] == hips || tree.is_above(hips, bones[0]));
        Some(parts)
    }

    fn with_head(&self, tree: &Tree, mut parts: Parts, named: &[(usize, Words)]) -> Parts {
        let arms = Side::BOTH.map(|side| parts[&BodyPart::UpperArm(side)][0]);
        let fits = |words: &Words| words.side.is_none() && ends_with(&words.joined, self.head);
        let mut heads = named.iter().filter(|(_, words)| fits(words)).take(CANDIDATES);
        let chest = tree.common(&arms);
        let head = heads.find(|(bone, _)| {
            chest.is_some_and(|chest| tree.is_above(chest, *bone))
                && !arms.iter().any(|&arm| tree.is_above(arm, *bone))
        });
        let head = head.map(|&(bone, _)| bone);
        let numbered = || last_of_spine(tree, chest?, named);
        if let Some(head) = head.or_else(numbered) {
            parts.insert(BodyPart::Head, vec![head]);
        }
        parts
    }

    /// Returns bones whose name is that of a part: of one in [`PAIRED`], or of the hips.
    fn candidates(
        &self,
        named: &[(usize, Words)],
        side: Option<Side>,
        part: Option<usize>,
    ) -> Vec<usize> {
        let fits = |words: &Words| {
            let longest = |names: &[&str]| {
                let fitting = names.iter().filter(|name| words.joined.ends_with(**name));
                fitting.map(|name| name.len()).max().unwrap_or(0)
            };
            let own = longest(part.map_or(self.hips, |part| self.paired[part]));
            // `forearm` ends with `arm`, and is none.
            let others = self.paired.iter().map(|names| longest(names)).max().unwrap_or(0);
            own > 0 && (side.is_none() || own >= others)
        };
        let named = named.iter().filter(|(_, words)| words.side == side && fits(words));
        named.map(|&(bone, _)| bone).take(CANDIDATES).collect()
    }
}

/// Returns the last of the bones above the chest that are numbered on as it is: Rigify calls neck
/// and head `spine.004` to `spine.006`.
fn last_of_spine(tree: &Tree, chest: usize, named: &[(usize, Words)]) -> Option<usize> {
    let stem = |bone: usize| {
        let (_, words) = named.iter().find(|(other, _)| *other == bone)?;
        let stem = words.joined.trim_end_matches(|letter: char| letter.is_ascii_digit());
        (words.side.is_none() && stem.len() < words.joined.len()).then_some(stem)
    };
    let own = stem(chest)?;
    let next =
        |&bone: &usize| tree.children[bone].iter().copied().find(|&child| stem(child) == Some(own));
    std::iter::successors(next(&chest), next).last()
}

fn ends_with(joined: &str, names: &[&str]) -> bool {
    names.iter().any(|name| joined.ends_with(name))
}

/// Returns the first bones, one of each list, that hang on each other.
fn first_chain(tree: &Tree, lists: &[Vec<usize>]) -> Option<Vec<usize>> {
    let (first, rest) = lists.split_first()?;
    first.iter().find_map(|&bone| {
        let mut chain = vec![bone];
        for list in rest {
            let last = chain[chain.len() - 1];
            chain.push(*list.iter().find(|&&next| tree.is_above(last, next))?);
        }
        Some(chain)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spine_that_is_numbered_on_ends_in_the_head() {
        let bone = |(index, name): (usize, &&str)| super::super::tree::Bone {
            name: (*name).to_owned(),
            parent: index.checked_sub(1),
            place: glam::DVec3::Y,
            turn: glam::DQuat::IDENTITY,
            scale: glam::DVec3::ONE,
            turns: true,
        };
        for (names, head) in [
            (["spine", "spine.003", "spine.004", "spine.006", "face"], Some(3)),
            (["spine", "DEF-spine.003", "DEF-spine.004", "jaw", "tongue.001"], Some(2)),
            (["spine", "spine.003", "tail.001", "tail.002", "tail.003"], None),
            (["spine", "chest", "spine.001", "neck", "top"], None),
        ] {
            let tree = Tree::new(names.iter().enumerate().map(bone).collect()).unwrap();
            let words = |&bone: &usize| Some((bone, Words::of(&tree.bones[bone].name)?));
            let named: Vec<(usize, Words)> = tree.order.iter().filter_map(words).collect();
            assert_eq!(last_of_spine(&tree, 1, &named), head, "{names:?}");
        }
    }

    #[test]
    fn names_say_side_and_part_whoever_gave_them() {
        let read = |name: &str| Words::of(name).map(|words| (words.joined, words.side));
        for (name, joined, side) in [
            ("mixamorig:LeftUpLeg", "upleg", Some(Side::Left)),
            ("thigh_l", "thigh", Some(Side::Left)),
            ("DEF-upper_arm.R", "defupperarm", Some(Side::Right)),
            ("J_Bip_L_LowerLeg", "jbiplowerleg", Some(Side::Left)),
            ("Bip01 R Forearm", "bip01forearm", Some(Side::Right)),
            ("lThighBend", "thighbend", Some(Side::Left)),
            ("LHipJoint", "hipjoint", Some(Side::Left)),
            ("KneeRight", "knee", Some(Side::Right)),
            ("leftforearm", "forearm", Some(Side::Left)),
            ("左足首", "足首", Some(Side::Left)),
            ("Bip001 L Toe0", "bip001toe0", Some(Side::Left)),
            ("upperleg01.L", "upperleg", Some(Side::Left)),
            ("upperleg02.L", "upperleg02", Some(Side::Left)),
            ("Pelvis", "pelvis", None),
        ] {
            assert_eq!(read(name), Some((joined.to_owned(), side)), "{name}");
        }
        for helper in ["ik_foot_l", "upperarm_twist_01_r", "LeftToe_End", "MCH-thigh.L"] {
            assert_eq!(read(helper), None, "{helper}");
        }
    }
}
