//! One pose of a decoded motion.

use ndarray::ArrayView1;

/// x, y and z of every joint in metres, the root at 0.
pub(crate) type Pose = Vec<[f32; 3]>;

/// Returns the joints of one decoded frame. The root's velocity and turn are no part of a pose.
pub(crate) fn pose(columns: ArrayView1<'_, f32>, joints: usize) -> Pose {
    let place = |joint| match joint {
        0 => [0.0; 3],
        _ => std::array::from_fn(|axis| columns[3 * joint + axis]),
    };
    (0..joints).map(place).collect()
}
