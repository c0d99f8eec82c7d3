//! Joints of SMPL among those of another rig, by name; the ones it lacks, by those around them.

use bailando::{
    evaluation::{BvhFile, BvhJoint, BvhPose},
    formats::TargetSkeleton,
    motion::Skeleton,
};
use glam::DVec3;

use super::super::JOINTS;

/// Names of the joints in BVH files of the first suits, which many programs still write; SMPL
/// order, empty where there is none.
const CLASSIC: [&str; JOINTS] = [
    "Hips",
    "LeftHip",
    "RightHip",
    "",
    "LeftKnee",
    "RightKnee",
    "Chest",
    "LeftAnkle",
    "RightAnkle",
    "Chest2",
    "LeftToe",
    "RightToe",
    "Neck",
    "LeftCollar",
    "RightCollar",
    "Head",
    "LeftShoulder",
    "RightShoulder",
    "LeftElbow",
    "RightElbow",
    "LeftWrist",
    "RightWrist",
    "",
    "",
];
/// Joints without which there is no figure: pelvis, hips, knees, ankles, shoulders, elbows, wrists.
const NEEDED: [usize; 13] = [0, 1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21];
/// Joints in a row: one that is missing lies between its neighbours, or beyond the last.
const CHAINS: [&[usize]; 5] =
    [&[0, 3, 6, 9, 12, 15], &[9, 13, 16], &[9, 14, 17], &[18, 20, 22], &[19, 21, 23]];
/// Ankles and toes: these do not lie in line with the shin.
const TOES: [[usize; 2]; 2] = [[7, 10], [8, 11]];
/// Joint names that a message shows.
const SHOWN: usize = 8;

/// Where the joints of SMPL are in a file.
#[derive(Debug)]
pub(super) struct Rig<'a> {
    file: &'a BvhFile,
    places: [Option<usize>; JOINTS],
    /// Lengths of our bones, metres.
    lengths: [f64; JOINTS],
}

impl<'a> Rig<'a> {
    /// Finds the joints.
    pub(super) fn recognise(file: &'a BvhFile, skeleton: &Skeleton) -> Result<Self, String> {
        let rigs = TargetSkeleton::ALL.map(|target| {
            let names = skeleton.joints.iter().map(move |joint| target.bone_name(joint));
            names.map(Option::unwrap_or_default).collect::<Vec<String>>()
        });
        let classic = CLASSIC.map(str::to_owned).to_vec();
        let found = rigs.into_iter().chain([classic]).map(|names| places(&file.joints, &names));
        let best = found.max_by_key(|places| places.iter().flatten().count());
        let places = best.unwrap_or([None; JOINTS]);
        let lengths = std::array::from_fn(|joint| skeleton.offset(joint).as_dvec3().length());
        let rig = Self { file, places, lengths };
        let missing = NEEDED.iter().find(|&&joint| rig.joint(joint).is_none());
        if let Some(&missing) = missing {
            let names = file.joints.iter().take(SHOWN).map(|joint| joint.name.as_str());
            return Err(format!(
                "its joints are of no rig that is known (SMPL, Mixamo, VRM, Unreal, classic BVH): \
                 no {} among {}, ..",
                skeleton.joints.get(missing).map_or("joint", String::as_str),
                names.collect::<Vec<_>>().join(", ")
            ));
        }
        if let Some([ankle, _]) = TOES.iter().find(|[ankle, toe]| {
            rig.joint(*toe).is_none() && rig.joint(*ankle).is_none_or(|joint| joint.end.is_none())
        }) {
            let name = rig.joint(*ankle).map_or("", |joint| joint.name.as_str());
            return Err(format!("it has no toes: neither a joint nor an end site after {name}"));
        }
        Ok(rig)
    }

    fn joint(&self, joint: usize) -> Option<&BvhJoint> {
        self.file.joints.get((*self.places.get(joint)?)?)
    }

    /// Returns the 24 joints of a frame in the file's unit.
    pub(super) fn points(&self, pose: &BvhPose) -> [DVec3; JOINTS] {
        let place = |joint: usize| pose.places.get(self.places[joint]?).copied();
        let mut points: [Option<DVec3>; JOINTS] = std::array::from_fn(place);
        for [ankle, toe] in TOES {
            if points[toe].is_none() {
                points[toe] = self.end_site(ankle, pose);
            }
        }
        for chain in CHAINS {
            for (at, &joint) in chain.iter().enumerate().skip(1) {
                if points[joint].is_none() {
                    points[joint] = Some(self.between(chain, at, &points));
                }
            }
        }
        points.map(Option::unwrap_or_default)
    }

    fn end_site(&self, joint: usize, pose: &BvhPose) -> Option<DVec3> {
        let at = self.places[joint]?;
        let turn = pose.world.get(at)?;
        Some(*pose.places.get(at)? + *turn * self.joint(joint)?.end?)
    }

    /// The joint before is known; with none known after, the chain goes straight on.
    fn between(&self, chain: &[usize], at: usize, points: &[Option<DVec3>; JOINTS]) -> DVec3 {
        let point = |place: usize| points[chain[place]].unwrap_or_default();
        let before = point(at - 1);
        let after = (at + 1..chain.len()).find(|&place| points[chain[place]].is_some());
        let own = self.lengths[chain[at]];
        match after {
            Some(after) => {
                let rest: f64 = chain[at + 1..=after].iter().map(|&j| self.lengths[j]).sum();
                before.lerp(point(after), own / (own + rest))
            }
            None if at > 1 => {
                let bone = before - point(at - 2);
                before + bone * own / self.lengths[chain[at - 1]]
            }
            None => before,
        }
    }

    /// Returns the length of our legs in units of the file's, which a pose shows.
    pub(super) fn leg_ratio(&self, points: &[DVec3; JOINTS]) -> f64 {
        const LEGS: [[usize; 2]; 4] = [[1, 4], [4, 7], [2, 5], [5, 8]];
        let theirs: f64 = LEGS.iter().map(|&[from, to]| points[from].distance(points[to])).sum();
        let ours: f64 = LEGS.iter().map(|&[_, to]| self.lengths[to]).sum();
        ours / theirs
    }
}

/// Finds joints by their names.
fn places(joints: &[BvhJoint], names: &[String]) -> [Option<usize>; JOINTS] {
    let found: Vec<String> = joints.iter().map(|joint| plain(&joint.name)).collect();
    std::array::from_fn(|joint| {
        let name = plain(names.get(joint)?);
        found.iter().position(|other| !name.is_empty() && *other == name)
    })
}

/// A name without what programs put before it, and however they write it: `mixamorig:LeftToeBase`,
/// `Left_Toe`.
fn plain(name: &str) -> String {
    let name = name.rsplit(':').next().unwrap_or_default();
    let name: String = name.chars().filter(|c| c.is_alphanumeric()).collect();
    let name = name.to_lowercase();
    let name = name.strip_prefix("mixamorig").unwrap_or(&name);
    name.strip_suffix("base").unwrap_or(name).to_owned()
}
