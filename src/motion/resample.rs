//! Other frame rates, by interpolation of rotations and root.

use glam::Quat;

use super::{Animation, MotionError};

/// Frame rates a dance can be had at (API.md).
pub const FRAME_RATES: [u32; 4] = [20, 24, 30, 60];

/// The same motion at `fps`: spherical interpolation of rotations, linear of the root.
/// `frames = ceil(frames before * fps / fps before)`; a last frame that falls after the last one
/// given repeats it.
///
/// # Errors
/// [`MotionError::FrameRate`] if `fps` is not one of [`FRAME_RATES`].
pub fn resample(animation: &Animation, fps: u32) -> Result<Animation, MotionError> {
    if !FRAME_RATES.contains(&fps) || animation.fps == 0 {
        return Err(MotionError::FrameRate { got: fps });
    }
    if fps == animation.fps {
        return Ok(animation.clone());
    }
    let (from, to) = (u64::from(animation.fps), u64::from(fps));
    let before = animation.root.len().min(animation.rotations.len());
    let frames = (before as u64 * to).div_ceil(from);
    let mut root = Vec::with_capacity(before);
    let mut rotations: Vec<Vec<Quat>> = Vec::with_capacity(before);
    for frame in 0..frames {
        // In whole numbers, so that frames which exist are taken as they are however long the dance.
        let (index, rest) = (frame * from / to, frame * from % to);
        let here = (index as usize).min(before - 1);
        let next = (here + 1).min(before - 1);
        let part = rest as f32 / to as f32;
        root.push(animation.root[here].lerp(animation.root[next], part));
        let mut pose: Vec<Quat> = animation.rotations[here]
            .iter()
            .zip(&animation.rotations[next])
            .map(|(&a, &b)| a.slerp(b, part).normalize())
            .collect();
        // Frames that were neighbours no longer are.
        if let Some(last) = rotations.last() {
            for (q, &before) in pose.iter_mut().zip(last) {
                if q.dot(before) < 0.0 {
                    *q = -*q;
                }
            }
        }
        rotations.push(pose);
    }
    Ok(Animation {
        fps,
        root,
        rotations,
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    /// One joint that turns about y at a steady rate while the root moves along x.
    fn turning(frames: usize) -> Animation {
        Animation {
            fps: 60,
            root: (0..frames).map(|i| Vec3::X * (i as f32 / 60.0)).collect(),
            rotations: (0..frames)
                .map(|i| vec![Quat::from_rotation_y(3.0 * i as f32 / 60.0)])
                .collect(),
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
    }

    #[test]
    fn existing_frames_are_taken_as_they_are() {
        let before = turning(301);
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
        for fps in [0, 1, 25, 59, 120] {
            assert_eq!(
                resample(&turning(10), fps),
                Err(MotionError::FrameRate { got: fps })
            );
        }
    }
}
