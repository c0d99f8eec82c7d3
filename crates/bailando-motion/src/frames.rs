//! Frames that come and go: what is pushed at the end leaves at the front.

use ndarray::{Axis, Slice};

use super::{Animation, Positions};

/// Puts `more` behind `all`, which may have no frames yet.
pub(super) fn append(all: &mut Positions, more: Positions) {
    if all.is_empty() {
        *all = more;
        return;
    }
    // Fails only for other numbers of joints: those are checked where positions come from.
    let joined = all.append(Axis(0), more.view());
    debug_assert!(joined.is_ok());
}

/// Takes the first `count` frames out.
pub(super) fn take_front(all: &mut Positions, count: usize) -> Positions {
    let rest = all.slice_axis(Axis(0), Slice::from(count..)).to_owned();
    let mut front = std::mem::replace(all, rest);
    front.slice_axis_inplace(Axis(0), Slice::from(..count));
    front
}

impl Animation {
    /// Without frames.
    pub(super) fn empty(fps: u32) -> Self {
        Self {
            fps,
            root: Vec::new(),
            rotations: Vec::new(),
        }
    }

    /// Puts the frames of `more` behind its own.
    pub(super) fn append(&mut self, more: Self) {
        self.root.extend(more.root);
        self.rotations.extend(more.rotations);
    }

    /// Takes the first `count` frames out.
    pub(super) fn take_front(&mut self, count: usize) -> Self {
        let root = self.root.split_off(count);
        let rotations = self.rotations.split_off(count);
        Self {
            fps: self.fps,
            root: std::mem::replace(&mut self.root, root),
            rotations: std::mem::replace(&mut self.rotations, rotations),
        }
    }
}
