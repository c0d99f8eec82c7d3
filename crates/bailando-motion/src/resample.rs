//! Other frame rates, by interpolation of rotations and root.

use glam::Quat;

use crate::{
    animation::{Animation, FrameQueue},
    error::MotionError,
};

/// Frame rates that a motion can have (API.md).
pub const FRAME_RATES: [u32; 4] = [20, 24, 30, 60];

/// Returns the same motion at `fps`: spherical interpolation of rotations, linear of the root.
///
/// `frames = ceil(frames before * fps / fps before)`; a last frame that falls after the last one
/// given repeats it.
///
/// # Errors
/// [`MotionError::FrameRate`] if `fps` is not one of [`FRAME_RATES`].
pub fn resample(animation: &Animation, fps: u32) -> Result<Animation, MotionError> {
    let mut resampler = Resampler::new(animation.fps, fps)?;
    let mut resampled = resampler.push(animation.clone());
    resampled.push_frames(resampler.end());
    Ok(resampled)
}

/// [`resample`], piece by piece: a frame is released once the one after it is known.
#[derive(Clone, Debug)]
pub(crate) struct Resampler {
    from: u64,
    to: u64,
    /// Number of the next frame to release.
    next: u64,
    /// Number of frames before those that are kept.
    gone: u64,
    kept: Animation,
    last: Vec<Quat>,
}

impl Resampler {
    /// # Errors
    /// As [`resample`].
    pub(crate) fn new(from: u32, to: u32) -> Result<Self, MotionError> {
        if !FRAME_RATES.contains(&to) || from == 0 {
            return Err(MotionError::FrameRate { got: to });
        }
        Ok(Self {
            from: from.into(),
            to: to.into(),
            next: 0,
            gone: 0,
            kept: Animation::empty(from),
            last: Vec::new(),
        })
    }

    /// Takes the next frames; returns those that lie before the last one known.
    pub(crate) fn push(&mut self, animation: Animation) -> Animation {
        if self.from == self.to {
            return animation;
        }
        self.kept.push_frames(animation);
        let known = self.gone + self.kept.root.len() as u64;
        self.release(known.saturating_sub(1))
    }

    /// Returns the rest.
    pub(crate) fn end(&mut self) -> Animation {
        self.release(self.gone + self.kept.root.len() as u64)
    }

    /// Releases all frames that lie before the frame `end` of those that came in.
    fn release(&mut self, end: u64) -> Animation {
        let mut resampled = Animation::empty(self.to as u32);
        // In whole numbers, so that existing frames are taken as they are in a motion of any
        // length.
        while self.next * self.from / self.to < end {
            let index = self.next * self.from / self.to;
            let rest = self.next * self.from % self.to;
            let here = (index - self.gone) as usize;
            let next = (here + 1).min(self.kept.root.len() - 1);
            let part = rest as f32 / self.to as f32;
            let (root, rotations) = (&self.kept.root, &self.kept.rotations);
            resampled.root.push(root[here].lerp(root[next], part));
            let pairs = rotations[here].iter().zip(&rotations[next]);
            let mut pose: Vec<Quat> = pairs.map(|(&a, &b)| a.slerp(b, part).normalize()).collect();
            // Signs are continuous between neighbours in the input, which these no longer are.
            for (q, &before) in pose.iter_mut().zip(&self.last) {
                if q.dot(before) < 0.0 {
                    *q = -*q;
                }
            }
            self.last.clone_from(&pose);
            resampled.rotations.push(pose);
            self.next += 1;
        }
        let done = (self.next * self.from / self.to).min(end) - self.gone;
        self.kept.take_frames(done as usize);
        self.gone += done;
        resampled
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    /// One joint that turns about y at a steady rate while the root moves along x.
    fn turning(frames: usize) -> Animation {
        let seconds = |frame: usize| frame as f32 / 60.0;
        Animation {
            fps: 60,
            root: (0..frames).map(|i| Vec3::X * seconds(i)).collect(),
            rotations: (0..frames).map(|i| vec![Quat::from_rotation_y(3.0 * seconds(i))]).collect(),
        }
    }

    #[test]
    fn frame_counts_are_rounded_up() {
        for frames in [0_usize, 1, 2, 3, 59, 60, 61, 480, 1803] {
            for fps in FRAME_RATES {
                let got = resample(&turning(frames), fps).unwrap();
                let expected = (frames * fps as usize).div_ceil(60);
                assert_eq!((got.root.len(), got.rotations.len()), (expected, expected));
                assert_eq!(got.fps, fps);
            }
        }
    }

    #[test]
    fn steady_motion_stays_on_its_path() {
        let before = turning(601);
        for fps in FRAME_RATES {
            let after = resample(&before, fps).unwrap();
            for (i, (root, pose)) in after.root.iter().zip(&after.rotations).enumerate() {
                let seconds = (i as f32 / fps as f32).min(10.0);
                assert!((root.x - seconds).abs() < 1e-5);
                let expected = Quat::from_rotation_y(3.0 * seconds);
                assert!(pose[0].dot(expected).abs() > 1.0 - 1e-6);
            }
        }
        // Frames that exist are taken as they are.
        let after = resample(&before, 20).unwrap();
        assert_eq!(after.root[100], before.root[300]);
        assert!(after.rotations[7][0].dot(before.rotations[21][0]).abs() > 1.0 - 1e-7);
    }

    #[test]
    fn signs_stay_continuous_when_frames_are_dropped() {
        let mut spinning = turning(120);
        for (i, pose) in spinning.rotations.iter_mut().enumerate() {
            pose[0] = Quat::from_rotation_x(1.4 * i as f32);
        }
        let after = resample(&spinning, 20).unwrap();
        for pair in after.rotations.windows(2) {
            assert!(pair[0][0].dot(pair[1][0]) >= 0.0);
        }
    }

    #[test]
    fn other_rates_are_refused() {
        for got in [0, 1, 25, 59, 120] {
            assert_eq!(resample(&turning(10), got), Err(MotionError::FrameRate { got }));
        }
    }
}
