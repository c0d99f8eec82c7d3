//! How far decoded feet move where those of the recording stand.

use burn_tensor::Tensor;

use super::{
    crops::change,
    feet::FEET,
    piece::MotionPiece,
    world::{lengths, world_steps},
};
use crate::{
    data::Draw,
    nn::{Kernels, gathered},
};

/// Gathers whether feet of crops stand, 1 or 0, `[batch, frames - 1, 2]`.
fn standing<B: Kernels>(
    pieces: &[MotionPiece],
    windows: &[Draw],
    frames: usize,
    device: &B::Device,
) -> Tensor<B, 3> {
    let row = |window: &Draw, step: usize| {
        let stands = pieces[window.dance].stands(window.frames(frames).start + step);
        let [left, right] = stands.map(|stands| f32::from(u8::from(stands)));
        if window.mirrored { [right, left] } else { [left, right] }
    };
    gathered(windows, [frames - 1, FEET.len()], row, device)
}

/// Where the columns of each foot begin among those of a half; `None` for a half without feet.
pub(super) fn foot_columns(columns: &[Option<usize>]) -> Option<[usize; 2]> {
    let [left, right] =
        FEET.map(|foot| columns.iter().position(|&column| column == Some(3 * foot)));
    Some([left?, right?])
}

/// Standing feet of a batch of crops.
pub(super) struct Standing<B: Kernels> {
    /// `[batch, frames - 1, 2]`.
    stands: Tensor<B, 3>,
    feet: [usize; 2],
}

impl<B: Kernels> Standing<B> {
    /// Gathers those of crops of a half with these columns; `None` for a half without feet.
    pub(super) fn of(
        columns: &[Option<usize>],
        (pieces, windows): (&[MotionPiece], &[Draw]),
        frames: usize,
        device: &B::Device,
    ) -> Option<Self> {
        let feet = foot_columns(columns)?;
        Some(Self { stands: standing(pieces, windows, frames, device), feet })
    }

    /// Computes the mean change of an error of positions from frame to frame, over standing feet.
    pub(super) fn velocity_error(&self, error: &Tensor<B, 3>) -> Tensor<B, 1> {
        let [left, right] = self.feet.map(|first| change(error.clone().narrow(2, first, 3)));
        self.mean([left, right].map(lengths))
    }

    /// Computes the mean way of standing feet over the floor, metres a frame, of decoded joints
    /// `[batch, frames, columns]` and the root's velocity, and turn in the dancer's frame,
    /// `[batch, frames, 3 or 4]`.
    pub(super) fn way(&self, joints: &Tensor<B, 3>, root: &Tensor<B, 3>) -> Tensor<B, 1> {
        let ways = self.feet.map(|first| {
            let steps = world_steps(&joints.clone().narrow(2, first, 3), root);
            lengths(steps.squeeze_dim(2))
        });
        self.mean(ways)
    }

    /// Computes the mean of a value of each foot over those that stand.
    fn mean(&self, feet: [Tensor<B, 3>; 2]) -> Tensor<B, 1> {
        let all = Tensor::cat(feet.into(), 2);
        (all * self.stands.clone()).sum() / self.stands.clone().sum().add_scalar(1.0)
    }
}

#[cfg(test)]
mod tests {
    use bailando::motion::MotionFrame;
    use burn_flex::{Flex, FlexDevice};

    use super::*;
    use crate::{
        nn::values,
        training::{crops::motion_columns, feet::tests::positions},
    };

    fn columns() -> Vec<Option<usize>> {
        [10, 11].iter().flat_map(|joint| (3 * joint..3 * joint + 3).map(Some)).collect()
    }

    #[test]
    fn feet_are_found_among_the_columns() {
        assert_eq!(foot_columns(&columns()), Some([0, 3]));
        assert_eq!(foot_columns(&[None, Some(3)]), None);
    }

    #[test]
    fn the_way_of_a_standing_foot_is_none_in_either_frame_and_side() {
        for (frame, root) in
            [(MotionFrame::World, &[0, 1, 2][..]), (MotionFrame::Dancer, &[0, 1, 2, 72])]
        {
            let pieces = [MotionPiece::from_positions(positions(), frame).unwrap()];
            let root: Vec<_> = root.iter().copied().map(Some).collect();
            for mirrored in [false, true] {
                let windows = [Draw { mirrored, start: 4, ..Draw::default() }];
                let gather = |columns: &[Option<usize>]| {
                    motion_columns::<Flex>(&pieces, &windows, 32, columns, &FlexDevice)
                };
                let standing =
                    Standing::<Flex>::of(&columns(), (&pieces, &windows), 32, &FlexDevice);
                let standing = standing.unwrap();
                let (joints, root) = (gather(&columns()), gather(&root));
                let stands: f32 = values(&standing.stands).iter().sum();
                assert_eq!(stands, 15.0);
                let way = values(&standing.way(&joints, &root))[0];
                assert!(way < 2e-5, "{frame:?} {mirrored} {way}");
                // A root that is a centimetre a frame too quick takes the foot along.
                let quick = root.clone().slice_assign(
                    [0..1, 0..32, 2..3],
                    root.clone().narrow(2, 2, 1).add_scalar(0.01),
                );
                let way = values(&standing.way(&joints, &quick))[0];
                assert!((way - 0.01 * 15.0 / 16.0).abs() < 2e-5, "{frame:?} {mirrored} {way}");
                let error = joints.zeros_like();
                assert!(values(&standing.velocity_error(&error))[0] < 2e-5);
            }
        }
    }
}
