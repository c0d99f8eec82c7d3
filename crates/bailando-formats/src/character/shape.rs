//! Bones by hierarchy and rest pose: a trunk with a pair of legs below and a pair of arms above.

use bailando_motion::{BodyPart, Side};
use glam::DVec3;

use super::{
    parts::{Parts, with_trunk},
    tree::Tree,
};

/// Two limbs are a pair where their lengths differ by less than this share.
const ALIKE: f64 = 0.15;
/// Branches of one bone that are looked at, the longest first.
const BRANCHES: usize = 12;

/// The longest way down from a bone.
#[derive(Clone, Copy, Debug)]
struct Way {
    length: f64,
    end: usize,
}

/// Two branches of one bone that mirror each other.
#[derive(Clone, Debug)]
struct Pair {
    on: usize,
    /// The ways from the bone to both ends, without the ends of bones.
    ways: [Vec<usize>; 2],
    length: f64,
}

/// Finds a humanoid by its shape: the longest pairs of branches, on two bones of which one is above
/// the other, are legs and arms.
pub(super) fn find(tree: &Tree) -> Option<Parts> {
    let ways = longest_ways(tree);
    let mut pairs: Vec<Pair> =
        tree.order.iter().flat_map(|&bone| pairs_on(tree, &ways, bone)).collect();
    pairs.sort_by(|a, b| b.length.total_cmp(&a.length));
    pairs.truncate(BRANCHES);
    let all = || pairs.iter().enumerate();
    let mut two =
        all().flat_map(|(index, one)| all().skip(index + 1).map(move |(_, two)| (one, two)));
    two.find_map(|(one, two)| body(tree, &ways, one, two))
}

/// Returns the longest way down from every bone.
fn longest_ways(tree: &Tree) -> Vec<Way> {
    let mut ways: Vec<Way> =
        (0..tree.bones.len()).map(|bone| Way { length: 0.0, end: bone }).collect();
    for &bone in tree.order.iter().rev() {
        if let Some(parent) = tree.bones[bone].parent {
            let length = ways[bone].length + tree.places[bone].distance(tree.places[parent]);
            if length > ways[parent].length {
                ways[parent] = Way { length, end: ways[bone].end };
            }
        }
    }
    ways
}

fn pairs_on(tree: &Tree, ways: &[Way], bone: usize) -> Vec<Pair> {
    let length = |child: usize| ways[child].length + tree.places[child].distance(tree.places[bone]);
    let mut branches: Vec<usize> = tree.children[bone].clone();
    branches.sort_by(|&a, &b| length(b).total_cmp(&length(a)));
    branches.truncate(BRANCHES);
    let way = |child: usize| {
        let (mut way, end) = (vec![child], ways[child].end);
        if end != child {
            way.extend(tree.between(child, end));
            way.push(end);
        }
        way.retain(|&bone| tree.bones[bone].turns);
        way
    };
    let mut pairs = Vec::new();
    for (index, &one) in branches.iter().enumerate() {
        for &other in branches.iter().skip(index + 1) {
            let lengths = [length(one), length(other)];
            let longer = lengths[0].max(lengths[1]);
            let ends = [one, other].map(|child| tree.places[ways[child].end]);
            let alike = (lengths[0] - lengths[1]).abs() < ALIKE * longer;
            if alike && ends[0].distance(ends[1]) > 0.05 * longer {
                let ways = [one, other].map(way);
                if mirror(tree, &ways, longer) {
                    pairs.push(Pair { on: bone, ways, length: longer });
                }
            }
        }
    }
    pairs
}

/// Whether two ways of at least three bones have bones of the same lengths.
fn mirror(tree: &Tree, ways: &[Vec<usize>; 2], length: f64) -> bool {
    let length_of = |pair: &[usize]| tree.places[pair[0]].distance(tree.places[pair[1]]);
    let [one, other] = ways.each_ref().map(|way| way.windows(2).map(length_of));
    let same = |(a, b): (f64, f64)| (a - b).abs() < ALIKE * a.max(b) + 0.02 * length;
    ways[0].len() >= 3 && ways[0].len() == ways[1].len() && one.zip(other).all(same)
}

/// Makes a body of two pairs of limbs; none if they are not arms and legs.
fn body(tree: &Tree, ways: &[Way], one: &Pair, two: &Pair) -> Option<Parts> {
    let (legs, arms) = match [tree.is_above(one.on, two.on), tree.is_above(two.on, one.on)] {
        [true, _] => (one, two),
        [_, true] => (two, one),
        _ => return None,
    };
    // Arms do not hang on a leg.
    if legs.ways.iter().flatten().any(|&bone| bone == arms.on || tree.is_above(bone, arms.on)) {
        return None;
    }
    let ends = |pair: &Pair| pair.ways.each_ref().map(|way| tree.places[way[way.len() - 1]]);
    let chest = tree.places[arms.on];
    let feet = ends(legs);
    let up = (chest - 0.5 * (feet[0] + feet[1])).try_normalize()?;
    let [upper_leg, lower_leg, foot, toes] = [0, 1, 2, 3].map(|at| {
        legs.ways.each_ref().map(|way| limb(tree, way).and_then(|start| way.get(start + at)))
    });
    let ahead = match (foot, toes) {
        ([Some(&a), Some(&b)], [Some(&c), Some(&d)]) => {
            tree.places[c] + tree.places[d] - tree.places[a] - tree.places[b]
        }
        _ => DVec3::Z,
    };
    let left = up.cross(ahead - up * ahead.dot(up)).try_normalize()?;
    let is_left = |places: [DVec3; 2]| (places[0] - places[1]).dot(left) > 0.0;
    let mut parts = Parts::new();
    let mut put = |part: BodyPart, bone: Option<&usize>| {
        if let Some(&bone) = bone {
            parts.insert(part, vec![bone]);
        }
    };
    let legs_left = if is_left(feet) { 0 } else { 1 };
    let arms_left = if is_left(ends(arms)) { 0 } else { 1 };
    for side in Side::BOTH {
        let leg = if side == Side::Left { legs_left } else { 1 - legs_left };
        put(BodyPart::UpperLeg(side), upper_leg[leg]);
        put(BodyPart::LowerLeg(side), lower_leg[leg]);
        put(BodyPart::Foot(side), foot[leg]);
        put(BodyPart::Toes(side), toes[leg]);
        let way = &arms.ways[if side == Side::Left { arms_left } else { 1 - arms_left }];
        let start = limb(tree, way)?;
        put(BodyPart::Shoulder(side), start.checked_sub(1).and_then(|at| way.get(at)));
        put(BodyPart::UpperArm(side), way.get(start));
        put(BodyPart::LowerArm(side), way.get(start + 1));
        put(BodyPart::Hand(side), way.get(start + 2));
    }
    put(BodyPart::Head, head(tree, ways, arms).as_ref());
    with_trunk(tree, parts, |_, _| Some(legs.on))
}

/// Returns where on its way a limb begins: before its two longest bones in a row.
fn limb(tree: &Tree, way: &[usize]) -> Option<usize> {
    let length = |pair: &[usize]| tree.places[pair[0]].distance(tree.places[pair[1]]);
    let lengths: Vec<f64> = way.windows(2).map(length).collect();
    let starts = 0..lengths.len().checked_sub(1)?;
    starts.max_by(|&a, &b| {
        let shorter = |at: usize| lengths[at].min(lengths[at + 1]);
        shorter(a).total_cmp(&shorter(b))
    })
}

/// Returns the last bone that turns on the longest way up from the chest that is no arm; the one
/// before it where the last of three or more ends the head.
fn head(tree: &Tree, ways: &[Way], arms: &Pair) -> Option<usize> {
    let is_arm = |child: &&usize| arms.ways.iter().any(|way| way[0] == **child);
    let free = tree.children[arms.on].iter().filter(|child| !is_arm(child));
    let &neck = free.max_by(|&&a, &&b| ways[a].length.total_cmp(&ways[b].length))?;
    let end = ways[neck].end;
    let mut up: Vec<usize> = std::iter::once(end).chain(tree.above(end)).collect();
    up.truncate(up.iter().position(|&bone| bone == neck)? + 1);
    up.retain(|&bone| tree.bones[bone].turns);
    let is_end = up.len() > 2 && up.first().is_some_and(|&last| tree.children[last].is_empty());
    up.get(usize::from(is_end)).copied()
}
