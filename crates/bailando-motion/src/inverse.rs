//! Inverse kinematics: joint positions to local rotations on the rest skeleton.

use glam::{DQuat, DVec3, Quat, Vec3};

use super::{
    Animation, MotionError, Positions, Skeleton,
    fit::{best_rotation, smallest_rotation},
    root::check_finite,
};

/// Bones shorter than this, in metres, have no direction.
pub(super) const SHORTEST_BONE: f64 = 1e-6;
/// Fastest change of a bone's twist beyond what its direction carries along, radians a second.
/// Dancers' limbs stay far below it; only the neighbourhood of a half turn from rest reaches it.
pub(super) const TWIST_RATE: f64 = 30.0;

/// Finds the rotations that put a rest skeleton on given joint positions.
///
/// A joint with several children gets the best-fitting rotation, one with a single child the
/// smallest rotation from the rest direction in its parent's frame, a leaf the identity. Planned
/// once per skeleton.
#[derive(Clone, Debug)]
pub struct InverseKinematics {
    bones: Vec<Bone>,
}

/// One joint with all that solving it needs.
#[derive(Clone, Debug)]
struct Bone {
    parent: Option<usize>,
    children: Vec<Child>,
}

#[derive(Clone, Debug)]
struct Child {
    joint: usize,
    offset: DVec3,
}

impl InverseKinematics {
    /// Plans for a skeleton.
    ///
    /// # Errors
    /// [`MotionError::Skeleton`] if it contradicts itself.
    pub fn new(skeleton: &Skeleton) -> Result<Self, MotionError> {
        skeleton.validate()?;
        let mut bones: Vec<Bone> = (0..skeleton.joints.len())
            .map(|joint| Bone {
                parent: skeleton.parent(joint),
                children: Vec::new(),
            })
            .collect();
        for (joint, &offset) in skeleton.offsets.iter().enumerate() {
            if let Some(parent) = skeleton.parent(joint) {
                let offset = Vec3::from_array(offset).as_dvec3();
                bones[parent].children.push(Child { joint, offset });
            }
        }
        Ok(Self { bones })
    }

    /// Local rotations for `positions` `[frames, joints, 3]` (metres, world space) at `fps`.
    ///
    /// Quaternions are of unit length and keep their sign along time. Bones without length keep the
    /// previous frame's rotation.
    ///
    /// # Errors
    /// [`MotionError::Shape`] if the joints are not the skeleton's, [`MotionError::NotFinite`] for a
    /// NaN or an infinity.
    pub fn solve(&self, positions: &Positions, fps: u32) -> Result<Animation, MotionError> {
        self.solve_on(&mut self.start(fps), positions)
    }

    /// What solving frame by frame at `fps` starts from.
    pub(super) fn start(&self, fps: u32) -> Solving {
        Solving {
            pose: Pose::new(self.bones.len(), TWIST_RATE / f64::from(fps.max(1))),
            fps,
        }
    }

    /// [`InverseKinematics::solve`] of a piece behind those that `solving` has seen.
    pub(super) fn solve_on(
        &self,
        solving: &mut Solving,
        positions: &Positions,
    ) -> Result<Animation, MotionError> {
        let (frames, joints, axes) = positions.dim();
        if joints != self.bones.len() || axes != 3 {
            return Err(MotionError::Shape {
                expected: format!("[frames, {}, 3]", self.bones.len()),
                got: format!("[{frames}, {joints}, {axes}]"),
            });
        }
        check_finite(positions)?;
        let Solving { pose, fps } = solving;
        let mut root = Vec::with_capacity(frames);
        let mut rotations = Vec::with_capacity(frames);
        for frame in positions.outer_iter() {
            for (place, p) in pose.places.iter_mut().zip(frame.outer_iter()) {
                *place = DVec3::new(p[0].into(), p[1].into(), p[2].into());
            }
            for (joint, bone) in self.bones.iter().enumerate() {
                pose.solve_joint(joint, bone);
            }
            pose.started = true;
            root.push(Vec3::new(frame[[0, 0]], frame[[0, 1]], frame[[0, 2]]));
            rotations.push(
                pose.local
                    .iter()
                    .map(|q| q.as_quat().normalize())
                    .collect::<Vec<Quat>>(),
            );
        }
        Ok(Animation {
            fps: *fps,
            root,
            rotations,
        })
    }
}

/// How far the rotations of one dance are solved.
#[derive(Clone, Debug)]
pub(super) struct Solving {
    pose: Pose,
    fps: u32,
}

/// The frame being solved; `local` still holds the previous frame's rotation of joints to come.
#[derive(Clone, Debug)]
struct Pose {
    places: Vec<DVec3>,
    local: Vec<DQuat>,
    world: Vec<DQuat>,
    started: bool,
    max_twist: f64,
}

impl Pose {
    fn new(joints: usize, max_twist: f64) -> Self {
        Self {
            places: vec![DVec3::ZERO; joints],
            local: vec![DQuat::IDENTITY; joints],
            world: vec![DQuat::IDENTITY; joints],
            started: false,
            max_twist,
        }
    }

    fn solve_joint(&mut self, joint: usize, bone: &Bone) {
        let above = bone.parent.map_or(DQuat::IDENTITY, |p| self.world[p]);
        let into_parent = above.inverse();
        let origin = self.places[joint];
        let seen = |child: &Child| into_parent * (self.places[child.joint] - origin);
        let previous = self.local[joint];
        let local = match bone.children.as_slice() {
            [] => previous,
            [child] => {
                let ends = (child.offset.try_normalize(), seen(child));
                match ends {
                    (Some(rest), bone) if bone.length() > SHORTEST_BONE => smallest_rotation(
                        rest,
                        bone.normalize(),
                        self.started.then_some(previous),
                        self.max_twist,
                    ),
                    _ => previous,
                }
            }
            children => best_rotation(
                children.iter().map(|child| (child.offset, seen(child))),
                previous,
            ),
        };
        let local = if local.dot(previous) < 0.0 {
            -local
        } else {
            local
        };
        self.local[joint] = local;
        self.world[joint] = (above * local).normalize();
    }
}
