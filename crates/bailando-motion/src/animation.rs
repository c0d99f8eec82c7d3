//! The two forms of a motion, rotations and positions, and the queue of frames that each can be.

use std::mem;

use glam::{DVec3, Quat, Vec3};
use ndarray::{Array3, ArrayView1, Axis, Slice};

/// Joint positions in metres, world space: `[frames, joints, 3]`.
pub type Positions = Array3<f32>;

/// A motion as local rotations on a skeleton.
#[derive(Clone, Debug, PartialEq)]
pub struct Animation {
    /// Frames per second.
    pub fps: u32,
    /// World position of the root joint, one per frame, metres.
    pub root: Vec<Vec3>,
    /// Local unit quaternions, `[frame][joint]`, sign-continuous along time.
    pub rotations: Vec<Vec<Quat>>,
}

impl Animation {
    /// Creates an animation without frames.
    pub(crate) fn empty(fps: u32) -> Self {
        Self { fps, root: Vec::new(), rotations: Vec::new() }
    }
}

/// A queue of frames.
pub(crate) trait FrameQueue {
    /// Appends frames at the end.
    fn push_frames(&mut self, more: Self);

    /// Removes the first `count` frames; without copying what stays if `count` is zero.
    fn take_frames(&mut self, count: usize) -> Self;
}

impl FrameQueue for Animation {
    fn push_frames(&mut self, more: Self) {
        self.root.extend(more.root);
        self.rotations.extend(more.rotations);
    }

    fn take_frames(&mut self, count: usize) -> Self {
        Self {
            fps: self.fps,
            root: take_first(&mut self.root, count),
            rotations: take_first(&mut self.rotations, count),
        }
    }
}

impl FrameQueue for Positions {
    /// The number of joints is that of the first frames.
    fn push_frames(&mut self, more: Self) {
        if self.is_empty() {
            *self = more;
        } else {
            #[expect(clippy::expect_used, reason = "one solver checks the joints of all pieces")]
            self.append(Axis(0), more.view()).expect("all frames of a motion have the same joints");
        }
    }

    fn take_frames(&mut self, count: usize) -> Self {
        let (frames, joints, axes) = self.dim();
        if count == 0 {
            return Self::zeros((0, joints, axes));
        }
        let rest = if count == frames {
            Self::zeros((0, joints, axes))
        } else {
            self.slice_axis(Axis(0), Slice::from(count..)).to_owned()
        };
        let mut front = mem::replace(self, rest);
        front.slice_axis_inplace(Axis(0), Slice::from(..count));
        front
    }
}

fn take_first<T>(all: &mut Vec<T>, count: usize) -> Vec<T> {
    if count == all.len() { mem::take(all) } else { all.drain(..count).collect() }
}

/// Reads one joint's position, x y z in metres.
pub(crate) fn position(joint: ArrayView1<'_, f32>) -> DVec3 {
    DVec3::new(joint[0].into(), joint[1].into(), joint[2].into())
}
