//! From the decoder's output to a finished motion: root, rotations, legs, floor, clean-up, frame
//! rate.

use ndarray::{ArrayView2, Axis};
use serde::Serialize;

use crate::{
    animation::{Animation, FrameQueue, Positions},
    clean::Cleaner,
    error::MotionError,
    floor::lower_foot_heights,
    floor_tracker::FloorTracker,
    forward::forward,
    inverse::{InverseKinematics, Solution},
    legs::{LegFitter, Legs},
    mirror::Mirror,
    resample::Resampler,
    root::integrate_from,
    seam::{Seam, SeamBlend},
    skeleton::Skeleton,
};

/// Frames that [`finish_while`] finishes between two questions.
const PIECE: usize = 1024;

/// What is made of a decoder's output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinishOptions {
    /// Frames per second wanted: one of [`crate::FRAME_RATES`].
    pub fps: u32,
    /// Whether the dancer travels; `false` holds x and z of the root at 0 and keeps y.
    pub root_motion: bool,
    /// Whether left and right are exchanged.
    pub mirror: bool,
    /// Frames per second of the decoder's output.
    pub decoded_fps: u32,
    /// Where the root starts: x and z in metres.
    pub start: [f32; 2],
    /// Whether feet are held in place, joints kept within their limits and jitter removed.
    pub clean: bool,
    /// Where positions come from. The decoder's own need its frame rate, and no clean-up.
    pub positions: PositionsSource,
}

impl Default for FinishOptions {
    fn default() -> Self {
        Self {
            fps: 60,
            root_motion: true,
            mirror: false,
            decoded_fps: 60,
            start: [0.0; 2],
            clean: true,
            positions: PositionsSource::ForwardKinematics,
        }
    }
}

/// The source of a motion's positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum PositionsSource {
    /// The decoder's own positions, at its own frame rate and without clean-up.
    Decoder,
    /// Forward kinematics of the motion's rotations.
    ForwardKinematics,
}

/// A motion that stands on the floor y = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// Rotations and root on the rest skeleton, at the wanted frame rate.
    pub animation: Animation,
    /// Joint positions `[frames, joints, 3]`, metres. The decoder's own have bones that stretch;
    /// the animation's feet follow theirs, and its root is within centimetres of theirs.
    pub positions: Positions,
    /// Where the positions come from.
    pub source: PositionsSource,
}

/// Finishes a decoder's output `[frames, 3 * joints]` (root velocity in columns 0..3, other joints
/// relative to the root, metres).
///
/// The root starts at the skeleton's `root_height`, inverse kinematics finds the rotations, the
/// legs are bent to the decoder's feet, slow vertical drift is removed, the motion is cleaned, and
/// the frame rate is changed where another is wanted.
///
/// # Errors
/// [`MotionError::FrameRate`] for a rate that is not offered, [`MotionError::DecoderPositions`] for
/// the decoder's own positions of another motion than its own, [`MotionError::Shape`] if the
/// columns are not the skeleton's, [`MotionError::NotFinite`] for a NaN or an infinity.
pub fn finish(
    decoded: ArrayView2<'_, f32>,
    skeleton: &Skeleton,
    options: &FinishOptions,
) -> Result<Finished, MotionError> {
    let mut finisher = Finisher::whole(skeleton, options)?;
    finisher.push(decoded)?;
    finisher.end()
}

/// [`finish`], given up with `None` as soon as `goes_on` says no.
///
/// # Errors
/// As [`finish`].
pub fn finish_while(
    decoded: ArrayView2<'_, f32>,
    skeleton: &Skeleton,
    options: &FinishOptions,
    goes_on: impl Fn() -> bool,
) -> Result<Option<Finished>, MotionError> {
    let mut finisher = Finisher::whole(skeleton, options)?;
    for piece in decoded.axis_chunks_iter(Axis(0), PIECE) {
        if !goes_on() {
            return Ok(None);
        }
        finisher.push(piece)?;
    }
    finisher.end().map(Some)
}

/// Finishes one motion piece by piece, as [`finish`] does it at once.
#[derive(Clone, Debug)]
pub struct Finisher {
    skeleton: Skeleton,
    options: FinishOptions,
    mirror: Option<Mirror>,
    root: [f32; 3],
    solver: InverseKinematics,
    solution: Solution,
    legs: LegFitter,
    grounded: Grounding<Animation>,
    cleaner: Option<Cleaner>,
    resampler: Resampler,
    /// Joins a motion that is not cleaned to one that it continues.
    seam: Option<SeamBlend>,
    /// The last two frames released.
    last: Animation,
    /// The decoder's own positions, where they are wanted.
    decoder: Option<Grounding<Positions>>,
}

/// Frames on their way to the floor; `lifts` holds what is to be added to the height of the first.
#[derive(Clone, Debug)]
struct Grounding<T> {
    floor: FloorTracker,
    frames: T,
    lifts: Vec<f32>,
}

impl Finisher {
    /// Creates a finisher that releases each frame as soon as it is settled, 4 s after it came in
    /// (3 s without clean-up): heights differ from those of the whole motion by a few centimetres
    /// at most, and feet stand as far apart.
    ///
    /// # Errors
    /// As [`finish`].
    pub fn new(skeleton: &Skeleton, options: &FinishOptions) -> Result<Self, MotionError> {
        Self::with_floor(skeleton, options, FloorTracker::streaming(options.decoded_fps))
    }

    /// Creates a finisher that releases the whole motion at its end.
    ///
    /// # Errors
    /// As [`Finisher::new`].
    pub fn whole(skeleton: &Skeleton, options: &FinishOptions) -> Result<Self, MotionError> {
        Self::with_floor(skeleton, options, FloorTracker::whole(options.decoded_fps))
    }

    fn with_floor(
        skeleton: &Skeleton,
        options: &FinishOptions,
        floor: FloorTracker,
    ) -> Result<Self, MotionError> {
        let FinishOptions { fps, decoded_fps, clean, positions, start: [x, z], .. } = *options;
        let from_decoder = positions == PositionsSource::Decoder;
        if from_decoder && (clean || fps != decoded_fps) {
            return Err(MotionError::DecoderPositions { decoded_fps });
        }
        let solver = InverseKinematics::new(skeleton)?;
        let decoder =
            from_decoder.then(|| Grounding::new(floor.clone(), Positions::zeros((0, 0, 3))));
        Ok(Self {
            options: *options,
            mirror: options.mirror.then(|| Mirror::of(skeleton)),
            root: [x, skeleton.root_height, z],
            solution: solver.start(decoded_fps),
            solver,
            legs: Legs::new(skeleton).fit(decoded_fps),
            grounded: Grounding::new(floor, Animation::empty(decoded_fps)),
            cleaner: clean.then(|| Cleaner::new(skeleton, decoded_fps, None)),
            resampler: Resampler::new(decoded_fps, fps)?,
            seam: None,
            last: Animation::empty(fps),
            skeleton: skeleton.clone(),
            decoder,
        })
    }

    /// Begins where another motion ended, with its pose and speed; asked for before the first
    /// [`Finisher::push`]. The decoder's own positions stay as they are.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the seam has other joints.
    pub fn continuing(mut self, seam: Seam) -> Result<Self, MotionError> {
        let (joints, fps) = (self.skeleton.joints.len(), self.options.decoded_fps);
        if [seam.rotations.len(), seam.spins.len()] != [joints; 2] {
            return Err(MotionError::Shape {
                expected: format!("a seam of {joints} joints"),
                got: format!("{} rotations, {} spins", seam.rotations.len(), seam.spins.len()),
            });
        }
        let seam = Some(SeamBlend::new(seam, fps));
        match &mut self.cleaner {
            Some(cleaner) => *cleaner = Cleaner::new(&self.skeleton, fps, seam),
            None => self.seam = seam,
        }
        Ok(self)
    }

    /// Returns where the motion would go on from the last frame released; none before the second.
    #[must_use]
    pub fn seam(&self) -> Option<Seam> {
        let Animation { fps, root, rotations } = &self.last;
        let [before, last] = [root.len().checked_sub(2)?, root.len() - 1];
        Some(Seam::after([before, last].map(|frame| (root[frame], &rotations[frame][..])), *fps))
    }

    /// Takes the next rows of decoded motion `[frames, 3 joints]`; returns the frames that are
    /// settled, which may be none.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the columns are not the skeleton's, [`MotionError::NotFinite`] for
    /// a NaN or an infinity.
    pub fn push(&mut self, decoded: ArrayView2<'_, f32>) -> Result<Finished, MotionError> {
        let mirrored = self.mirror.as_ref().map(|mirror| mirror.apply(decoded));
        let decoded = mirrored.as_ref().map_or(decoded, |mirrored| mirrored.view());
        let decoded = integrate_from(decoded, &mut self.root)?;
        let solved = self.solver.continue_from(&mut self.solution, &decoded)?;
        let fitted = self.legs.push(solved, &decoded);
        self.ground(fitted)?;
        if let Some(decoder) = &mut self.decoder {
            let heights = lower_foot_heights(&decoded, &self.skeleton);
            decoder.push(decoded, heights);
        }
        let mut settled = self.settled();
        if let Some(seam) = &mut self.seam {
            settled = seam.push(settled);
        }
        if let Some(cleaner) = &mut self.cleaner {
            settled = cleaner.push(settled);
        }
        let resampled = self.resampler.push(settled);
        self.release(resampled)
    }

    /// Returns the rest of the motion.
    ///
    /// # Errors
    /// As [`Finisher::push`].
    pub fn end(&mut self) -> Result<Finished, MotionError> {
        let fitted = self.legs.end();
        self.ground(fitted)?;
        self.grounded.end();
        if let Some(decoder) = &mut self.decoder {
            decoder.end();
        }
        let mut settled = self.settled();
        if let Some(seam) = &mut self.seam {
            settled = seam.push(settled);
            settled.push_frames(seam.end());
        }
        if let Some(cleaner) = &mut self.cleaner {
            settled = cleaner.push(settled);
            settled.push_frames(cleaner.end());
        }
        let mut resampled = self.resampler.push(settled);
        resampled.push_frames(self.resampler.end());
        self.release(resampled)
    }

    /// Stands the skeleton on the floor by its own feet. They are where the decoder's are, but for
    /// legs that cannot reach, so this is the decoder's correction to within millimetres.
    fn ground(&mut self, fitted: Animation) -> Result<(), MotionError> {
        let heights = lower_foot_heights(&forward(&self.skeleton, &fitted)?, &self.skeleton);
        self.grounded.push(fitted, heights);
        Ok(())
    }

    /// Returns the frames whose floor is settled, for rotations and positions alike.
    fn settled(&mut self) -> Animation {
        let settled = self.grounded.lifts.len();
        let positions = self.decoder.as_ref().map_or(settled, |decoder| decoder.lifts.len());
        self.grounded.release(settled.min(positions))
    }

    /// Releases the next frames.
    fn release(&mut self, mut animation: Animation) -> Result<Finished, MotionError> {
        if !self.options.root_motion {
            for root in &mut animation.root {
                (root.x, root.z) = (0.0, 0.0);
            }
        }
        let count = animation.root.len();
        for frame in count.saturating_sub(2)..count {
            self.last.root.push(animation.root[frame]);
            self.last.rotations.push(animation.rotations[frame].clone());
        }
        self.last.take_frames(self.last.root.len().saturating_sub(2));
        let positions = match &mut self.decoder {
            None => forward(&self.skeleton, &animation)?,
            Some(decoder) => decoder.release(count, self.options.root_motion),
        };
        Ok(Finished { animation, positions, source: self.options.positions })
    }
}

impl<T: FrameQueue> Grounding<T> {
    fn new(floor: FloorTracker, frames: T) -> Self {
        Self { floor, frames, lifts: Vec::new() }
    }

    fn push(&mut self, frames: T, heights: Vec<f32>) {
        self.lifts.extend(self.floor.push(heights));
        self.frames.push_frames(frames);
    }

    fn end(&mut self) {
        self.lifts.extend(self.floor.end());
    }
}

impl Grounding<Animation> {
    fn release(&mut self, count: usize) -> Animation {
        let mut animation = self.frames.take_frames(count);
        for (root, lift) in animation.root.iter_mut().zip(self.lifts.drain(..count)) {
            root.y += lift;
        }
        animation
    }
}

impl Grounding<Positions> {
    fn release(&mut self, count: usize, root_motion: bool) -> Positions {
        let mut positions = self.frames.take_frames(count);
        for (mut pose, lift) in positions.outer_iter_mut().zip(self.lifts.drain(..count)) {
            let held = match root_motion {
                true => [0.0, 0.0],
                false => [pose[[0, 0]], pose[[0, 2]]],
            };
            for mut joint in pose.outer_iter_mut() {
                joint[0] -= held[0];
                joint[1] += lift;
                joint[2] -= held[1];
            }
        }
        positions
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whole_motion_is_not_copied_at_every_push() {
        let skeleton = Skeleton::fixture();
        let options = FinishOptions {
            clean: false,
            positions: PositionsSource::Decoder,
            ..FinishOptions::default()
        };
        let mut finisher = Finisher::whole(&skeleton, &options).unwrap();
        let rows = ndarray::Array2::zeros((8, 72));
        let buffers = |finisher: &Finisher| {
            let decoder = finisher.decoder.as_ref().unwrap();
            (decoder.frames.as_ptr(), finisher.grounded.frames.root.as_ptr())
        };
        let (mut moved, mut before) = ((0, 0), buffers(&finisher));
        for _ in 0..256 {
            finisher.push(rows.view()).unwrap();
            let now = buffers(&finisher);
            moved.0 += usize::from(now.0 != before.0);
            moved.1 += usize::from(now.1 != before.1);
            before = now;
        }
        // A buffer that doubles when it is full moves 9 times on the way to 256 pushes.
        assert!(moved.0 <= 9 && moved.1 <= 9, "buffers moved {moved:?} times");
    }
}
