//! Characters of callers, made here: humanoids of any size, with the names, axes and files of
//! several programs.

mod body;
mod bvh;
mod glb;

use glam::{DQuat, DVec3};

pub use body::{Body, RigBone};
pub use bvh::bvh;
pub use glb::{Glb, Humanoid, container, glb};

/// A rig with what a test has to know about it.
pub struct Rig {
    /// What it shows.
    pub name: &'static str,
    /// The file.
    pub bytes: Vec<u8>,
    /// Units of its world in a metre.
    pub unit: f64,
    /// Names of ankle and ball of both feet, left first.
    pub feet: [[String; 2]; 2],
    /// The bones of its body at rest, in metres: where it should dance and where it looks.
    pub body: Body,
    /// Direction in which it looks.
    pub ahead: DVec3,
}

/// Returns one rig of each kind.
pub fn all() -> Vec<Rig> {
    vec![mixamo(1.0), vrm0(), vrm1(), unreal(1.9), bvh_of_60_joints(), unnamed()]
}

fn feet(body: &Body) -> [[String; 2]; 2] {
    ["l", "r"].map(|side| ["foot", "toes"].map(|part| body.name(&format!("{side}_{part}"))))
}

/// A child of `height` metres from Mixamo: centimetres under a node that scales and turns them,
/// in a T-pose, bones along y, with long toes.
pub fn mixamo(height: f64) -> Rig {
    let mut body = Body::new(height, 0.8, 0.0);
    body.lengthen_toes();
    body.rename(&[
        ("hips", "mixamorig:Hips"),
        ("spine", "mixamorig:Spine"),
        ("chest", "mixamorig:Spine1"),
        ("upper_chest", "mixamorig:Spine2"),
        ("neck", "mixamorig:Neck"),
        ("head", "mixamorig:Head"),
        ("head_end", "mixamorig:HeadTop_End"),
    ]);
    body.rename_sides(
        ["mixamorig:Left", "mixamorig:Right"],
        "",
        &[
            ("shoulder", "Shoulder"),
            ("upper_arm", "Arm"),
            ("lower_arm", "ForeArm"),
            ("hand", "Hand"),
            ("finger", "HandIndex1"),
            ("upper_leg", "UpLeg"),
            ("lower_leg", "Leg"),
            ("foot", "Foot"),
            ("toes", "ToeBase"),
            ("toe_end", "Toe_End"),
        ],
    );
    body.point_axes(DVec3::Y);
    let file = Glb { armature: Some((0.01, DQuat::from_rotation_x(1.3))), ..Glb::default() };
    let (name, bytes) = ("Mixamo, 1.0 m", glb(&body, &file));
    Rig { name, bytes, unit: 1.0, feet: feet(&body), body, ahead: DVec3::Z }
}

/// An avatar of VRM 0, which looks to -z.
pub fn vrm0() -> Rig {
    let mut body = Body::new(1.45, 0.9, 0.0);
    body.turn(DQuat::from_rotation_y(std::f64::consts::PI));
    let file = Glb { humanoid: Humanoid::Vrm0, ..Glb::default() };
    body.rename_all(|part| format!("node of {part}"));
    let (name, bytes) = ("VRM 0, 1.45 m", glb(&body, &file));
    Rig { name, bytes, unit: 1.0, feet: feet(&body), body, ahead: DVec3::NEG_Z }
}

/// An avatar of VRM 1 in an A-pose, whose nodes are matrices with axes of their own.
pub fn vrm1() -> Rig {
    let mut body = Body::new(1.62, 1.0, 0.6);
    body.rename_all(|part| format!("{part}.{}", part.len()));
    body.point_axes(DVec3::Z);
    let file = Glb { humanoid: Humanoid::Vrm1, matrices: true, ..Glb::default() };
    let (name, bytes) = ("VRM 1, 1.62 m", glb(&body, &file));
    Rig { name, bytes, unit: 1.0, feet: feet(&body), body, ahead: DVec3::Z }
}

/// A mannequin of Unreal: A-pose, five bones of spine, two of neck, bones of twist and of inverse
/// kinematics, the left and the right with opposite axes.
pub fn unreal(height: f64) -> Rig {
    let mut body = Body::new(height, 1.05, 0.8);
    body.split("spine", "lower_spine");
    body.split("upper_chest", "middle_chest");
    body.split("neck", "upper_neck");
    body.rename(&[
        ("hips", "pelvis"),
        ("spine", "spine_02"),
        ("lower_spine", "spine_01"),
        ("chest", "spine_03"),
        ("middle_chest", "spine_04"),
        ("upper_chest", "spine_05"),
        ("neck", "neck_02"),
        ("upper_neck", "neck_01"),
        ("head", "head"),
    ]);
    body.rename_sides(
        ["", ""],
        "_",
        &[
            ("shoulder", "clavicle"),
            ("upper_arm", "upperarm"),
            ("lower_arm", "lowerarm"),
            ("hand", "hand"),
            ("finger", "index_01"),
            ("upper_leg", "thigh"),
            ("lower_leg", "calf"),
            ("foot", "foot"),
            ("toes", "ball"),
        ],
    );
    body.point_axes(DVec3::X);
    let extra = ["ik_foot_l", "ik_foot_r", "ik_hand_gun"].map(String::from).to_vec();
    let file = Glb { armature: Some((1.0, DQuat::IDENTITY)), extra, ..Glb::default() };
    let (name, bytes) = ("Unreal, 1.9 m", glb(&body, &file));
    Rig { name, bytes, unit: 1.0, feet: feet(&body), body, ahead: DVec3::Z }
}

/// A BVH of 60 joints in centimetres, z up, looking to -y, with six channels on every joint.
pub fn bvh_of_60_joints() -> Rig {
    let mut body = Body::new(1.75, 1.0, 0.0);
    body.split("spine", "lower_spine");
    body.split("neck", "upper_neck");
    for side in ["l", "r"] {
        body.fingers(side);
        body.hang(&format!("{side}_eye"), "head", DVec3::new(0.0, 0.03, 0.05));
    }
    body.hang("jaw", "head", DVec3::new(0.0, 0.01, 0.04));
    body.rename(&[("hips", "Hips"), ("head", "Head"), ("neck", "Neck1"), ("upper_neck", "Neck")]);
    body.rename_sides(
        ["Left", "Right"],
        "",
        &[
            ("shoulder", "Collar"),
            ("upper_arm", "Shoulder"),
            ("lower_arm", "Elbow"),
            ("hand", "Wrist"),
            ("upper_leg", "Hip"),
            ("lower_leg", "Knee"),
            ("foot", "Ankle"),
            ("toes", "Toe"),
        ],
    );
    body.turn(DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2));
    let (name, bytes) = ("BVH of 60 joints, 1.75 m", bvh(&body, 100.0).into_bytes());
    let feet = feet(&body);
    Rig { name, bytes, unit: 100.0, feet, body, ahead: DVec3::NEG_Y }
}

/// A rig whose names say nothing.
pub fn unnamed() -> Rig {
    let mut body = Body::new(1.7, 1.0, 0.4);
    let mut number = 0;
    body.rename_all(|_| {
        number += 1;
        format!("bone{number}")
    });
    let (name, bytes) = ("no names, 1.7 m", glb(&body, &Glb::default()));
    Rig { name, bytes, unit: 1.0, feet: feet(&body), body, ahead: DVec3::Z }
}
