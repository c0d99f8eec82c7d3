//! A caller's own character: read from BVH, GLB or VRM, its bones recognised, and given back with
//! a dance on them and nothing else changed.

mod bvh;
mod container;
mod glb;
mod limits;
mod mapping;
mod names;
mod parts;
mod pose;
mod refusal;
mod shape;
mod splice;
mod tree;
mod vrm;

use bailando_motion::{BodyPart, Retargeter};
use glam::DQuat;

pub use limits::RigLimits;
pub use mapping::{BoneNames, FoundBy, RigMapping};

use crate::{error::FormatError, motion::GeneratedMotion, target::TargetSkeleton};
use bvh::BvhFile;
use glb::GlbFile;
use parts::Parts;
use pose::Poses;
use refusal::problem;
use tree::Tree;

/// The kind of file that a rig is, and that the dance on it comes back as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RigFormat {
    /// Biovision hierarchy.
    Bvh,
    /// Binary glTF 2.0.
    Glb,
    /// Binary glTF 2.0 with VRM's extension, 0.x or 1.0.
    Vrm,
}

impl RigFormat {
    /// Returns the extension of its files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bvh => "bvh",
            Self::Glb => "glb",
            Self::Vrm => "vrm",
        }
    }

    /// Returns its media type.
    #[must_use]
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Bvh => "application/x-bvh",
            Self::Glb | Self::Vrm => "model/gltf-binary",
        }
    }
}

/// A caller's character.
#[derive(Clone, Debug)]
pub struct Character {
    file: File,
    tree: Tree,
    parts: Parts,
    mapping: RigMapping,
}

#[derive(Clone, Debug)]
enum File {
    Bvh(BvhFile),
    Glb(GlbFile),
}

impl Character {
    /// Reads a file and recognises its bones; those of `mapping` win.
    ///
    /// # Errors
    /// [`FormatError::RigTooLarge`] for too many bytes; [`FormatError::Rig`] says what is wrong
    /// with the file, its bones or the mapping.
    pub fn read(
        bytes: Vec<u8>,
        mapping: &RigMapping,
        limits: &RigLimits,
    ) -> Result<Self, FormatError> {
        if bytes.len() > limits.bytes {
            return Err(FormatError::RigTooLarge { limit: limits.bytes });
        }
        let (file, tree, humanoid) = if bvh::is_bvh(&bytes) {
            let (file, tree) = bvh::read(bytes, limits)?;
            (File::Bvh(file), tree, None)
        } else if container::is_glb(&bytes) {
            let (file, tree, humanoid) = glb::read(bytes, limits)?;
            (File::Glb(file), tree, humanoid)
        } else {
            return problem("its first bytes are those of neither BVH nor GLB");
        };
        let (parts, found_by) = mapping::find(&tree, humanoid, mapping)?;
        pose::check_scales(&tree, &parts)?;
        let bones = pose::ordered(&parts).into_iter().map(|(_, bone)| bone);
        if let File::Bvh(file) = &file {
            file.check_turns(&tree, bones)?;
            // Its own check has found the hips.
            let hips = parts.get(&BodyPart::Hips).and_then(|bones| bones.first());
            file.carrier(&tree, hips.copied().unwrap_or_default())?;
        }
        let mapping = mapping::told(&tree, &parts, found_by);
        Ok(Self { file, tree, parts, mapping })
    }

    /// Returns which bone was taken for which part of the body.
    #[must_use]
    pub fn mapping(&self) -> &RigMapping {
        &self.mapping
    }

    /// Returns the kind of its file.
    #[must_use]
    pub fn format(&self) -> RigFormat {
        match &self.file {
            File::Bvh(_) => RigFormat::Bvh,
            File::Glb(file) if file.is_vrm => RigFormat::Vrm,
            File::Glb(_) => RigFormat::Glb,
        }
    }

    /// Returns about the most bytes that a dance of so many frames takes while it is written: its
    /// file, and two rotations of every bone that dances in every frame, in the world and its own.
    #[must_use]
    pub fn most_bytes(&self, frames: usize) -> usize {
        let bones: usize = self.parts.values().map(Vec::len).sum();
        let turns = frames.saturating_mul(2 * size_of::<DQuat>() * bones);
        turns.saturating_add(match &self.file {
            File::Bvh(file) => file.most_bytes(frames),
            File::Glb(file) => file.most_bytes(&self.parts, frames),
        })
    }

    /// Writes its file with a dance: BVH with the dance as its motion, GLB and VRM with one more
    /// animation. Feet are held in place on its own legs if they are to be `planted`.
    ///
    /// # Errors
    /// [`FormatError::Inconsistent`] if the motion's parts do not fit each other,
    /// [`FormatError::NoBone`] if it lacks joints of SMPL,
    /// [`FormatError::Figure`] if the bones in their rest pose are no standing humanoid, and
    /// [`FormatError::TooLong`] if the file would be too large for GLB.
    pub fn dance(&self, motion: &GeneratedMotion, planted: bool) -> Result<Vec<u8>, FormatError> {
        motion.check()?;
        let mut needed = TargetSkeleton::smpl_joints();
        if let Some(bone) = needed.find(|joint| !motion.skeleton.joints.iter().any(|j| j == joint))
        {
            return Err(FormatError::NoBone { bone: bone.into(), format: "dance on a rig" });
        }
        let figure = pose::figure(&self.tree, &self.parts, matches!(self.file, File::Glb(_)));
        let retargeter = Retargeter::new(&motion.skeleton, &figure).map_err(FormatError::Figure)?;
        let dance = retargeter.retarget(&motion.animation, planted).map_err(FormatError::Figure)?;
        let poses = Poses::new(&self.tree, &self.parts, dance);
        match &self.file {
            File::Bvh(file) => file.write(&self.tree, &poses),
            File::Glb(file) => file.write(&self.tree, &poses),
        }
    }
}
