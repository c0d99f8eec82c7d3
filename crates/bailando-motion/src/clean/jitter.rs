//! Removal of jitter: a short symmetric average, which has no delay and so moves no dance beat.

use glam::{Quat, Vec3};

use crate::animation::{Animation, FrameQueue};

/// Binomial weights of a frame and its neighbours on either side. They halve what trembles at 11 Hz
/// at 60 frames a second and pass 97 % at 2 Hz, the rate of a fast beat.
const WEIGHTS: [f32; 3] = [6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
const REACH: usize = WEIGHTS.len() - 1;

/// Averages rotations and root of a motion over five frames. Beyond its ends the motion goes on as
/// it came, mirrored in its end, so that first and last frame stay as they are.
#[derive(Clone, Debug)]
pub(super) struct JitterFilter {
    kept: Animation,
    /// The last frames released, as they were, the latest first; as many as there were.
    before: [Frame; REACH],
    started: bool,
}

#[derive(Clone, Debug, Default)]
struct Frame {
    root: Vec3,
    rotations: Vec<Quat>,
}

impl JitterFilter {
    pub(super) fn new(fps: u32) -> Self {
        Self { kept: Animation::empty(fps), before: Default::default(), started: false }
    }

    /// Takes the next frames; returns those whose neighbours are known.
    pub(super) fn push(&mut self, animation: Animation) -> Animation {
        self.kept.push_frames(animation);
        self.release(self.kept.root.len().saturating_sub(REACH))
    }

    /// Returns the rest.
    pub(super) fn end(&mut self) -> Animation {
        self.release(self.kept.root.len())
    }

    fn release(&mut self, count: usize) -> Animation {
        if count > 0 && !self.started {
            self.started = true;
            let last = self.kept.root.len() - 1;
            for (frame, reach) in self.before.iter_mut().zip(1..) {
                let inside = last.min(reach);
                let (roots, rotations) = (&self.kept.root, &self.kept.rotations);
                frame.root = mirrored(roots[0], roots[inside]);
                let pairs = rotations[0].iter().zip(&rotations[inside]);
                frame.rotations.extend(pairs.map(|(&end, &q)| turned_on(end, q)));
            }
        }
        for frame in 0..count {
            self.filter(frame);
        }
        self.kept.take_frames(count)
    }

    fn filter(&mut self, frame: usize) {
        let last = self.kept.root.len() - 1;
        // Frames ahead, or how far they lie beyond the last one.
        let ahead = [1, 2].map(|reach| (frame + reach).checked_sub(last + 1));
        let [one, other] = &mut self.before;
        let root = self.kept.root[frame];
        let roots = &mut self.kept.root;
        let next = |index: usize| match ahead[index] {
            None => roots[frame + index + 1],
            Some(beyond) => {
                let inside = match (last - frame, beyond) {
                    (0, 0) => one.root,
                    (0, _) => other.root,
                    _ => root,
                };
                mirrored(roots[last], inside)
            }
        };
        let [middle, near, far] = WEIGHTS;
        let smooth = root * middle + (one.root + next(0)) * near + (other.root + next(1)) * far;
        roots[frame] = smooth;
        other.root = one.root;
        one.root = root;
        for joint in 0..self.kept.rotations[frame].len() {
            let rotations = &mut self.kept.rotations;
            let here = rotations[frame][joint];
            let nearer = |q: Quat| if q.dot(here) < 0.0 { -q } else { q };
            let next = |index: usize| match ahead[index] {
                None => rotations[frame + index + 1][joint],
                Some(beyond) => {
                    let inside = match (last - frame, beyond) {
                        (0, 0) => one.rotations[joint],
                        (0, _) => other.rotations[joint],
                        _ => here,
                    };
                    turned_on(rotations[last][joint], inside)
                }
            };
            let sum = here * middle
                + (nearer(one.rotations[joint]) + nearer(next(0))) * near
                + (nearer(other.rotations[joint]) + nearer(next(1))) * far;
            rotations[frame][joint] = sum.normalize();
            other.rotations[joint] = one.rotations[joint];
            one.rotations[joint] = here;
        }
    }
}

/// Returns a place as far beyond `end` as `inside` lies before it.
fn mirrored(end: Vec3, inside: Vec3) -> Vec3 {
    2.0 * end - inside
}

/// Returns a rotation as far beyond `end` as `inside` lies before it.
fn turned_on(end: Quat, inside: Quat) -> Quat {
    (end * inside.inverse() * end).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filtered(animation: &Animation, piece: usize) -> Animation {
        let mut filter = JitterFilter::new(60);
        let mut rest = animation.clone();
        let mut done = Animation::empty(60);
        while !rest.root.is_empty() {
            let count = piece.min(rest.root.len());
            done.push_frames(filter.push(rest.take_frames(count)));
        }
        done.push_frames(filter.end());
        done
    }

    fn animation(frames: usize, place: impl Fn(f32) -> f32) -> Animation {
        let at = |frame: usize| place(frame as f32 / 60.0);
        Animation {
            fps: 60,
            root: (0..frames).map(|frame| Vec3::X * at(frame)).collect(),
            rotations: (0..frames).map(|frame| vec![Quat::from_rotation_z(at(frame))]).collect(),
        }
    }

    #[test]
    fn the_response_is_that_of_its_weights_and_without_delay() {
        for hertz in [0.5, 2.0, 11.0, 20.0] {
            let omega = std::f32::consts::TAU * hertz;
            let before = animation(240, |t| 0.1 * (omega * t).sin());
            let after = filtered(&before, 7);
            let [middle, near, far] = WEIGHTS;
            let turn = omega / 60.0;
            let gain = middle + 2.0 * near * turn.cos() + 2.0 * far * (2.0 * turn).cos();
            for frame in 2..238 {
                let wanted = gain * before.root[frame].x;
                assert!((after.root[frame].x - wanted).abs() < 1e-5, "{hertz} Hz");
                let angle = after.rotations[frame][0].to_scaled_axis().z;
                assert!((angle - wanted).abs() < 1e-3, "{hertz} Hz: {angle} {wanted}");
            }
        }
    }

    #[test]
    fn steady_motion_and_both_ends_stay_as_they_are() {
        for frames in [1, 2, 3, 4, 50] {
            let steady = animation(frames, |t| 0.3 + 2.0 * t);
            let jagged = animation(frames, |t| (900.0 * t).sin());
            for piece in [1, 3, 64] {
                for (a, b) in filtered(&steady, piece).root.iter().zip(&steady.root) {
                    assert!((a.x - b.x).abs() < 1e-5);
                }
                let after = filtered(&jagged, piece);
                assert_eq!(after.root.len(), frames);
                assert!((after.root[0].x - jagged.root[0].x).abs() < 1e-5);
                assert!((after.root[frames - 1].x - jagged.root[frames - 1].x).abs() < 1e-5);
            }
        }
    }
}
