//! The skeleton of every model that works in the SMPL joint order.

use bailando::motion::Skeleton;

/// Name, parent (-1 for the root) and offset from the parent in metres: the rest pose faces +z
/// with its left side towards +x.
#[rustfmt::skip]
const JOINTS: [(&str, i32, [f32; 3]); 24] = [
    ("pelvis", -1, [0.0, 0.0, 0.0]),
    ("l_hip", 0, [0.05858135, -0.08228004, -0.01766408]),
    ("r_hip", 0, [-0.06030973, -0.09051332, -0.01354254]),
    ("spine1", 0, [0.00443945, 0.12440352, -0.03838522]),
    ("l_knee", 1, [0.04345142, -0.38646945, 0.008037]),
    ("r_knee", 2, [-0.04325663, -0.3836879, -0.00484304]),
    ("spine2", 3, [0.00448844, 0.1379564, 0.02682033]),
    ("l_ankle", 4, [-0.01479032, -0.42687458, -0.037428]),
    ("r_ankle", 5, [0.01905555, -0.4200455, -0.03456167]),
    ("spine3", 6, [-0.00226458, 0.05603239, 0.00285505]),
    ("l_foot", 7, [0.04105436, -0.06028581, 0.12204243]),
    ("r_foot", 8, [-0.03483987, -0.06210566, 0.13032329]),
    ("neck", 9, [-0.0133902, 0.21163553, -0.03346758]),
    ("l_collar", 9, [0.07170245, 0.11399969, -0.01889817]),
    ("r_collar", 9, [-0.08295366, 0.11247234, -0.02370739]),
    ("head", 12, [0.01011321, 0.08893734, 0.05040987]),
    ("l_shoulder", 13, [0.12292141, 0.04520509, -0.019046]),
    ("r_shoulder", 14, [-0.11322832, 0.04685326, -0.00847207]),
    ("l_elbow", 16, [0.2553319, -0.01564902, -0.02294649]),
    ("r_elbow", 17, [-0.26012748, -0.01436928, -0.03126873]),
    ("l_wrist", 18, [0.26570925, 0.01269811, -0.00737473]),
    ("r_wrist", 19, [-0.26910836, 0.00679372, -0.00602676]),
    ("l_hand", 20, [0.08669055, -0.01063603, -0.01559429]),
    ("r_hand", 21, [-0.0887537, -0.00865157, -0.01010708]),
];

/// The rest skeleton, its root starting `root_height` metres above the floor.
#[must_use]
pub fn skeleton(root_height: f32) -> Skeleton {
    Skeleton {
        joints: JOINTS.iter().map(|(name, ..)| (*name).to_owned()).collect(),
        parents: JOINTS.iter().map(|&(_, parent, _)| parent).collect(),
        offsets: JOINTS.iter().map(|&(.., offset)| offset).collect(),
        root_height,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_skeleton_is_whole_and_symmetric() {
        let skeleton = skeleton(0.93);
        skeleton.validate().unwrap();
        for (joint, name) in skeleton.joints.iter().enumerate() {
            if let Some(right) = name.strip_prefix("l_") {
                let mirrored = skeleton.joints.iter().position(|n| *n == format!("r_{right}"));
                let mirrored = skeleton.offsets[mirrored.unwrap()];
                let [x, ..] = skeleton.offsets[joint];
                assert!(x * mirrored[0] < 0.0, "{name} and its mirror are on one side");
            }
        }
    }
}
