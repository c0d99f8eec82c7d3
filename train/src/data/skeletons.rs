//! Skeletons by their number of joints: those that hold SMPL's, and what others usually are.

use super::JOINTS;

/// Joints that SMPL shares with its successors: pelvis to wrists, without hands and face.
pub(super) const BODY: usize = 22;
/// Joints of SMPL-H, the body and two hands of fingers.
pub(super) const SMPL_H: usize = 52;
/// Joints of SMPL-X, SMPL-H's with jaw and eyes between.
pub(super) const SMPL_X: usize = 55;
/// Where SMPL-H has the hands of SMPL: the first joints of its middle fingers.
const HANDS: [usize; 2] = [25, 40];

/// Skeletons that motion data often have, by their number of joints.
const OTHERS: [(usize, &str); 12] = [
    (17, "COCO or Human3.6M"),
    (18, "OpenPose (COCO)"),
    (21, "KIT-ML"),
    (BODY, "SMPL's body without hands, as in HumanML3D"),
    (23, "SMPL without the pelvis, or Xsens"),
    (25, "OpenPose (BODY_25), Kinect or NTU"),
    (31, "CMU's ASF/AMC"),
    (33, "MediaPipe"),
    (SMPL_X, "SMPL-X"),
    (127, "SMPL-X with fingertips and face"),
    (133, "COCO-WholeBody"),
    (137, "OpenPose with hands and face"),
];

/// Returns frames and joints of `[frames, joints, 3]` or `[frames, 3 joints]`.
pub(super) fn layout(shape: &[usize]) -> Option<(usize, usize)> {
    match *shape {
        [frames, joints, 3] => Some((frames, joints)),
        [frames, columns] if columns.is_multiple_of(3) => Some((frames, columns / 3)),
        _ => None,
    }
}

/// Returns where each joint of SMPL is among `joints` joints; none where they are not its.
pub(super) fn smpl_joints(joints: usize) -> Option<[usize; JOINTS]> {
    let hand = |joint: usize| joint.checked_sub(BODY).and_then(|hand| HANDS.get(hand)).copied();
    match joints {
        JOINTS => Some(std::array::from_fn(|joint| joint)),
        SMPL_H => Some(std::array::from_fn(|joint| hand(joint).unwrap_or(joint))),
        _ => None,
    }
}

/// Says what a shape is that is none of the expected.
pub(super) fn refusal(name: &str, shape: &[usize], expected: &str) -> String {
    let known =
        layout(shape).and_then(|(_, joints)| OTHERS.iter().find(|&&(count, _)| count == joints));
    let whose = known.map(|(count, whose)| format!(": {count} joints are those of {whose}"));
    format!("{name} {shape:?}{}; expected {expected}", whose.unwrap_or_default())
}
