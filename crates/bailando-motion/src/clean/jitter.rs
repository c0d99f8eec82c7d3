//! Removal of jitter: a short symmetric average, which has no delay and so moves no dance beat.

use std::ops::{Add, Mul};

use glam::{Quat, Vec3};

use crate::animation::{Animation, FrameQueue};

/// Binomial weights of a frame and its neighbours on either side. They halve what trembles at 11 Hz
/// at 60 frames a second and pass 97 % at 2 Hz, the rate of a fast beat.
const WEIGHTS: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
const REACH: isize = 2;
/// Frames at either end of a motion through which the line goes that continues it beyond.
const ENDS: usize = 5;

/// Averages rotations and root of a motion over five frames. Beyond its ends the motion goes on in
/// a straight line.
#[derive(Clone, Debug)]
pub(super) struct JitterFilter {
    kept: Animation,
    /// The last frames released, as they were, the latest first, as many as there were; and one
    /// more that is being filtered.
    before: [Frame; ENDS],
    done: usize,
}

#[derive(Clone, Debug, Default)]
struct Frame {
    root: Vec3,
    rotations: Vec<Quat>,
}

impl JitterFilter {
    pub(super) fn new(fps: u32) -> Self {
        Self { kept: Animation::empty(fps), before: Default::default(), done: 0 }
    }

    /// Takes the next frames; returns those whose neighbours are known.
    pub(super) fn push(&mut self, animation: Animation) -> Animation {
        self.kept.push_frames(animation);
        self.release(self.kept.root.len().saturating_sub(ENDS - 1))
    }

    /// Returns the rest.
    pub(super) fn end(&mut self) -> Animation {
        self.release(self.kept.root.len())
    }

    fn release(&mut self, count: usize) -> Animation {
        for frame in 0..count {
            self.filter(frame);
            self.done += 1;
        }
        self.kept.take_frames(count)
    }

    /// Filters a frame of those kept, of which the ones before it are in `before` as they were.
    fn filter(&mut self, frame: usize) {
        let Self { kept: Animation { root, rotations, .. }, before, done } = self;
        let ends = (-(*done as isize), (root.len() - 1 - frame) as isize);
        let smooth = averaged(ends, |at| match before.get((-1 - at) as usize) {
            Some(frame) => frame.root,
            None => root[frame.strict_add_signed(at)],
        });
        let here = std::mem::replace(&mut root[frame], smooth);
        before.rotate_right(1);
        let [now, before @ ..] = before;
        now.root = here;
        now.rotations.clone_from(&rotations[frame]);
        for (joint, &here) in now.rotations.iter().enumerate() {
            let smooth = averaged(ends, |at| {
                let rotation = match before.get((-1 - at) as usize) {
                    Some(frame) => frame.rotations[joint],
                    None => rotations[frame.strict_add_signed(at)][joint],
                };
                if rotation.dot(here) < 0.0 { -rotation } else { rotation }
            });
            rotations[frame][joint] = smooth.normalize();
        }
    }
}

/// Averages `value` around 0; it is known from the first to the second of `ends`, and is continued
/// by the line through the five values at an end.
fn averaged<T: Copy + Add<Output = T> + Mul<f32, Output = T>>(
    (first, last): (isize, isize),
    value: impl Fn(isize) -> T,
) -> T {
    let beyond = |distance: isize, inside: &dyn Fn(isize) -> isize| {
        // Least squares through values 0 to 4, at minus the distance.
        let weight = |at: isize| 0.2 - 0.1 * (distance + 2) as f32 * (at - 2) as f32;
        let term = |at: isize| value(inside(at).clamp(first, last)) * weight(at);
        (1..ENDS as isize).fold(term(0), |sum, at| sum + term(at))
    };
    let term = |at: isize| match at {
        at if at < first => beyond(first - at, &|inside| first + inside),
        at if at > last => beyond(at - last, &|inside| last - inside),
        at => value(at),
    };
    let terms = WEIGHTS.iter().zip(-REACH..).map(|(&weight, at)| term(at) * weight);
    terms.reduce(|sum, term| sum + term).unwrap_or_else(|| value(0))
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
            let [far, near, middle, ..] = WEIGHTS;
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
    fn steady_motion_stays_as_it_is_to_its_ends() {
        for frames in [1, 2, 5, 6, 50] {
            let steady = animation(frames, |t| if frames < ENDS { 0.3 } else { 0.3 + 2.0 * t });
            for piece in [1, 3, 64] {
                let after = filtered(&steady, piece);
                assert_eq!(after.root.len(), frames);
                for (a, b) in after.root.iter().zip(&steady.root) {
                    assert!((a.x - b.x).abs() < 1e-5);
                }
                for (a, b) in after.rotations.iter().zip(&steady.rotations) {
                    assert!(a[0].angle_between(b[0]) < 1e-3);
                }
            }
        }
    }

    #[test]
    fn jitter_is_removed_at_the_ends_as_well() {
        let jagged = animation(50, |t| (60.0 * t * std::f32::consts::PI).cos());
        for root in &filtered(&jagged, 7).root {
            assert!(root.x.abs() < 0.5);
        }
    }
}
