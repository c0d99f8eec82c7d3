//! Finishing a motion while it is decoded.

use ndarray::ArrayView2;

use super::{
    Animation, FinishOptions, Finished, InverseKinematics, MotionError, Positions, PositionsSource,
    Skeleton,
    floor_line::FloorLine,
    forward, frames,
    inverse::Solving,
    leg::{Following, Legs},
    lower_foot_heights,
    resample::Resampler,
    root::walk_on,
};

/// Finishes one motion piece by piece, as [`super::finish`] does it at once.
#[derive(Clone, Debug)]
pub struct Finisher {
    skeleton: Skeleton,
    options: FinishOptions,
    root: [f32; 3],
    solver: InverseKinematics,
    solving: Solving,
    following: Following,
    resampler: Resampler,
    animation: Lane<Animation>,
    /// The decoder's own positions, where they have the wanted frame rate.
    decoder: Option<Lane<Positions>>,
}

/// Frames on their way to the floor.
#[derive(Clone, Debug)]
struct Lane<T> {
    floor: FloorLine,
    /// Do not stand yet.
    waiting: T,
    /// Stand on the floor.
    standing: T,
}

impl Finisher {
    /// For pieces as they come: the floor of a frame is settled 2.5 s behind what is known, so that a
    /// dance in pieces differs from the same as a whole by a few centimetres of height at most.
    ///
    /// # Errors
    /// As [`super::finish`].
    pub fn new(skeleton: &Skeleton, options: &FinishOptions) -> Result<Self, MotionError> {
        Self::start(skeleton, options, true)
    }

    /// For a motion that is wanted as a whole: all frames leave at the end.
    ///
    /// # Errors
    /// As [`super::finish`].
    pub fn whole(skeleton: &Skeleton, options: &FinishOptions) -> Result<Self, MotionError> {
        Self::start(skeleton, options, false)
    }

    fn start(
        skeleton: &Skeleton,
        options: &FinishOptions,
        as_known: bool,
    ) -> Result<Self, MotionError> {
        let solver = InverseKinematics::new(skeleton)?;
        let resampler = Resampler::new(options.decoded_fps, options.fps)?;
        let [x, z] = options.start;
        let floor = FloorLine::new(options.fps, as_known);
        Ok(Self {
            skeleton: skeleton.clone(),
            options: *options,
            root: [x, skeleton.root_height, z],
            solving: solver.start(options.decoded_fps),
            solver,
            following: Legs::new(skeleton).start(options.decoded_fps),
            resampler,
            animation: Lane {
                floor: floor.clone(),
                waiting: Animation::empty(options.fps),
                standing: Animation::empty(options.fps),
            },
            decoder: (options.fps == options.decoded_fps).then(|| Lane {
                floor,
                waiting: Positions::zeros((0, 0, 3)),
                standing: Positions::zeros((0, 0, 3)),
            }),
        })
    }

    /// Takes the next rows of decoded motion `[frames, 3 joints]` in; gives the frames that are settled,
    /// which may be none.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the columns are not the skeleton's, [`MotionError::NotFinite`] for a NaN or
    /// an infinity.
    pub fn push(&mut self, decoded: ArrayView2<'_, f32>) -> Result<Finished, MotionError> {
        let decoded = walk_on(decoded, &mut self.root)?;
        let solved = self.solver.solve_on(&mut self.solving, &decoded)?;
        let followed = self.following.push(solved, &decoded);
        let resampled = self.resampler.push(followed);
        self.animate(resampled)?;
        if let Some(lane) = &mut self.decoder {
            let lifts = lane
                .floor
                .push(lower_foot_heights(&decoded, &self.skeleton));
            frames::append(&mut lane.waiting, decoded);
            lane.stand(&lifts, self.options.root_motion);
        }
        self.leave()
    }

    /// The rest.
    ///
    /// # Errors
    /// As [`Finisher::push`].
    pub fn end(&mut self) -> Result<Finished, MotionError> {
        let followed = self.following.end();
        let mut resampled = self.resampler.push(followed);
        resampled.append(self.resampler.end());
        self.animate(resampled)?;
        let lifts = self.animation.floor.end();
        self.animation.stand(&lifts);
        if let Some(lane) = &mut self.decoder {
            let lifts = lane.floor.end();
            lane.stand(&lifts, self.options.root_motion);
        }
        self.leave()
    }

    /// Stands the skeleton on the floor by its own feet. They are where the decoder's are, but for legs that
    /// cannot reach, so this is the decoder's correction to within millimetres.
    fn animate(&mut self, mut resampled: Animation) -> Result<(), MotionError> {
        if !self.options.root_motion {
            for root in &mut resampled.root {
                (root.x, root.z) = (0.0, 0.0);
            }
        }
        let heights = lower_foot_heights(&forward(&self.skeleton, &resampled)?, &self.skeleton);
        let lifts = self.animation.floor.push(heights);
        self.animation.waiting.append(resampled);
        self.animation.stand(&lifts);
        Ok(())
    }

    /// What stands in both lanes.
    fn leave(&mut self) -> Result<Finished, MotionError> {
        let standing = self.animation.standing.root.len();
        let Some(lane) = &mut self.decoder else {
            let animation = self.animation.standing.take_front(standing);
            return Ok(Finished {
                positions: forward(&self.skeleton, &animation)?,
                animation,
                source: PositionsSource::ForwardKinematics,
            });
        };
        let count = standing.min(lane.standing.dim().0);
        Ok(Finished {
            animation: self.animation.standing.take_front(count),
            positions: frames::take_front(&mut lane.standing, count),
            source: PositionsSource::Decoder,
        })
    }
}

impl Lane<Animation> {
    fn stand(&mut self, lifts: &[f32]) {
        let mut next = self.waiting.take_front(lifts.len());
        for (root, lift) in next.root.iter_mut().zip(lifts) {
            root.y += lift;
        }
        self.standing.append(next);
    }
}

impl Lane<Positions> {
    fn stand(&mut self, lifts: &[f32], root_motion: bool) {
        let mut next = frames::take_front(&mut self.waiting, lifts.len());
        for (mut pose, lift) in next.outer_iter_mut().zip(lifts) {
            let held = if root_motion {
                [0.0, 0.0]
            } else {
                [pose[[0, 0]], pose[[0, 2]]]
            };
            for mut joint in pose.outer_iter_mut() {
                joint[0] -= held[0];
                joint[1] += lift;
                joint[2] -= held[1];
            }
        }
        frames::append(&mut self.standing, next);
    }
}
