//! Feet that stand: where recordings have them, and how far decoded feet move there.

use bailando::motion::Positions;
use burn_tensor::Tensor;
use ndarray::ArrayView1;

use super::{crops::change, piece::MotionPiece};
use crate::{
    data::{Draw, FPS},
    nn::{Kernels, gathered},
};

/// Balls of the feet, left and right, SMPL order.
const FEET: [usize; 2] = [10, 11];
/// Highest place of a ball that stands, metres: 3.6 cm in the street set, lower in the salsa set.
const HIGHEST: f32 = 0.05;
/// Quickest way of one, metres a second: recordings let standing feet slide a little.
const QUICKEST: f32 = 0.3;
/// Added to squares of ways, so that their root has a derivative at rest, (metres a frame)^2.
const REST: f64 = 1e-10;

/// Returns whether each foot stands from a frame to the next, left and right.
pub(super) fn contacts(positions: &Positions) -> Vec<[bool; 2]> {
    let frames = positions.outer_iter();
    let pairs = frames.zip(positions.outer_iter().skip(1));
    let stands = |now: ArrayView1<'_, f32>, next: ArrayView1<'_, f32>| {
        let squares = now.iter().zip(next).map(|(now, next)| (next - now) * (next - now));
        let way = squares.sum::<f32>().sqrt();
        now[1].max(next[1]) < HIGHEST && way * (FPS as f32) < QUICKEST
    };
    pairs.map(|(now, next)| FEET.map(|foot| stands(now.row(foot), next.row(foot)))).collect()
}

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
        self.mean([left, right].map(length))
    }

    /// Computes the mean way of standing feet over the floor, metres a frame, of decoded joints
    /// `[batch, frames, columns]` and the root's velocity, and turn in the dancer's frame,
    /// `[batch, frames, 3 or 4]`.
    pub(super) fn way(&self, joints: &Tensor<B, 3>, root: &Tensor<B, 3>) -> Tensor<B, 1> {
        let [_, frames, columns] = root.dims();
        let root = root.clone().narrow(1, 0, frames - 1);
        let velocity = root.clone().narrow(2, 0, 3);
        let turn = (columns > 3).then(|| root.narrow(2, 3, 1));
        let ways = self.feet.map(|first| {
            let foot = joints.clone().narrow(2, first, 3);
            let now = foot.clone().narrow(1, 0, frames - 1);
            let next = foot.narrow(1, 1, frames - 1);
            let next = match &turn {
                Some(turn) => turned(next, turn.clone()),
                None => next,
            };
            length(velocity.clone() + next - now)
        });
        self.mean(ways)
    }

    /// Computes the mean of a value of each foot over those that stand.
    fn mean(&self, feet: [Tensor<B, 3>; 2]) -> Tensor<B, 1> {
        let all = Tensor::cat(feet.into(), 2);
        (all * self.stands.clone()).sum() / self.stands.clone().sum().add_scalar(1.0)
    }
}

/// Turns vectors about +y: +z goes towards +x.
fn turned<B: Kernels>(vectors: Tensor<B, 3>, angle: Tensor<B, 3>) -> Tensor<B, 3> {
    let (sin, cos) = (angle.clone().sin(), angle.cos());
    let [x, y, z] = [0, 1, 2].map(|axis| vectors.clone().narrow(2, axis, 1));
    let across = x.clone() * cos.clone() + z.clone() * sin.clone();
    Tensor::cat(vec![across, y, z * cos - x * sin], 2)
}

/// Computes the lengths of vectors, `[batch, frames, 1]`.
fn length<B: Kernels>(vectors: Tensor<B, 3>) -> Tensor<B, 3> {
    vectors.square().sum_dim(2).add_scalar(REST).sqrt()
}

#[cfg(test)]
mod tests {
    use bailando::motion::MotionFrame;
    use burn_flex::{Flex, FlexDevice};

    use super::*;
    use crate::{data::JOINTS, nn::values, training::crops::motion_columns};

    const COUNT: usize = 40;

    /// A body that walks and turns; its left ball stands still at first, its right one slides.
    fn positions() -> Positions {
        Positions::from_shape_fn((COUNT, JOINTS, 3), |(frame, joint, axis)| {
            let time = frame as f32 / FPS as f32;
            let lifted = 0.2 * f32::from(u8::from(frame >= 20));
            let (sin, cos) = (0.8 * time).sin_cos();
            let side = 0.2 * f32::from(i8::from(joint % 3 == 1) - i8::from(joint % 3 == 2));
            match (joint, axis) {
                (10, _) => [0.1, 0.03 + lifted, 0.0][axis],
                (11, _) => [-0.1 - 0.5 * time, 0.03, 0.0][axis],
                (_, 0) => 0.4 * time + side * cos,
                (_, 1) => 0.9 + joint as f32 * 0.02,
                _ => 0.3 * time - side * sin,
            }
        })
    }

    fn columns() -> Vec<Option<usize>> {
        [10, 11].iter().flat_map(|joint| (3 * joint..3 * joint + 3).map(Some)).collect()
    }

    #[test]
    fn a_foot_stands_where_it_is_low_and_slow() {
        let found = contacts(&positions());
        assert_eq!(found.len(), COUNT - 1);
        assert_eq!((found[0], found[18]), ([true, false], [true, false]));
        assert_eq!((found[19], found[30]), ([false; 2], [false; 2]));
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
