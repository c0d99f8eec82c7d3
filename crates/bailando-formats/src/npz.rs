//! NumPy archive in the layout of AMASS, which research code on SMPL reads.
//!
//! AMASS is z up: `trans` and the root's rotation are turned a quarter about x. Poses are
//! axis-angle of SMPL-H's 52 joints, of which the first 22 are the body; hands rest.

use std::{
    f64::consts::FRAC_PI_2,
    io::{Cursor, Write},
};

use glam::DQuat;
use zip::{CompressionMethod, DateTime, ZipWriter, write::SimpleFileOptions};

use crate::{
    error::FormatError,
    motion::{GeneratedMotion, MotionSize},
    target::TargetSkeleton,
};

/// Joints of SMPL's body, without its two hands, which SMPL-H replaces by fingers.
const BODY: usize = 22;
/// Numbers of a pose of SMPL-H: 52 joints.
const POSE: usize = 3 * 52;
/// Shape parameters, as many as AMASS has.
const BETAS: usize = 16;
/// First bytes of a NumPy file, version 1.0.
const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
const ALIGNMENT: usize = 64;
/// Bytes of headers and of the parts that do not grow.
const FIXED_BYTES: usize = 4096;

/// About the most bytes of a motion in the layout of AMASS.
pub(crate) fn npz_bytes(size: MotionSize) -> usize {
    FIXED_BYTES + 4 * (POSE + 3) * size.frames
}

/// Writes a motion as a NumPy archive in the layout of AMASS: `poses` float32 `[frames, 156]`,
/// `trans` float32 `[frames, 3]` (the pelvis), `mocap_framerate`, `betas` float32 `[16]` (zeros)
/// and `gender` (`neutral`).
///
/// # Errors
/// [`FormatError::Inconsistent`] if the motion's parts do not fit each other or hold a NaN or an
/// infinity, [`FormatError::NoBone`] if its joints are not those of SMPL.
pub fn to_npz(motion: &GeneratedMotion) -> Result<Vec<u8>, FormatError> {
    motion.check()?;
    let order = body_joints(motion)?;
    let animation = &motion.animation;
    let frames = animation.root.len();
    let upright = DQuat::from_rotation_x(FRAC_PI_2);
    let mut archive = Archive::new(npz_bytes(motion.size()));
    archive.begin("poses", "<f4", &[frames, POSE])?;
    let mut pose = [0.0_f32; POSE];
    for rotations in &animation.rotations {
        for (place, &joint) in order.iter().enumerate() {
            let local = rotations[joint].as_dquat();
            let local = if place == 0 { upright * local } else { local };
            pose[3 * place..3 * place + 3].copy_from_slice(&axis_angle(local).to_array());
        }
        archive.floats(&pose)?;
    }
    archive.begin("trans", "<f4", &[frames, 3])?;
    for root in &animation.root {
        archive.floats(&(upright * root.as_dvec3()).as_vec3().to_array())?;
    }
    archive.begin("mocap_framerate", "<f8", &[])?;
    archive.bytes(&f64::from(animation.fps).to_le_bytes())?;
    archive.begin("betas", "<f4", &[BETAS])?;
    archive.floats(&[0.0; BETAS])?;
    let gender = "neutral";
    archive.begin("gender", &format!("<U{}", gender.len()), &[])?;
    for letter in gender.chars() {
        archive.bytes(&u32::from(letter).to_le_bytes())?;
    }
    archive.end()
}

/// Returns the motion's joints in the order of SMPL's body.
fn body_joints(motion: &GeneratedMotion) -> Result<Vec<usize>, FormatError> {
    let joints = &motion.skeleton.joints;
    let find = |name: &str| joints.iter().position(|joint| joint == name);
    let names = TargetSkeleton::smpl_joints().take(BODY);
    let missing = |name: &str| FormatError::NoBone { bone: name.into(), format: "npz" };
    names.map(|name| find(name).ok_or_else(|| missing(name))).collect()
}

/// Returns the rotation vector of at most half a turn.
fn axis_angle(rotation: DQuat) -> glam::Vec3 {
    let nearer = if rotation.w < 0.0 { -rotation } else { rotation };
    nearer.to_scaled_axis().as_vec3()
}

/// NumPy arrays in a zip archive without compression, as `numpy.savez` writes it.
struct Archive {
    zip: ZipWriter<Cursor<Vec<u8>>>,
}

impl Archive {
    fn new(bytes: usize) -> Self {
        Self { zip: ZipWriter::new(Cursor::new(Vec::with_capacity(bytes))) }
    }

    /// Begins an array; its numbers follow.
    fn begin(&mut self, name: &str, kind: &str, shape: &[usize]) -> Result<(), FormatError> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::DEFAULT)
            .large_file(true);
        self.zip.start_file(format!("{name}.npy"), options)?;
        let mut sizes = String::new();
        for size in shape {
            sizes += &format!("{size}, ");
        }
        let mut header = format!(
            "{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}",
            sizes.trim_end()
        );
        // The whole header is padded, its length of two bytes and its end of line counted.
        let length = (MAGIC.len() + 2 + header.len() + 1).next_multiple_of(ALIGNMENT);
        let padding = length - MAGIC.len() - 2 - header.len() - 1;
        header.extend(std::iter::repeat_n(' ', padding));
        header.push('\n');
        self.bytes(MAGIC)?;
        self.bytes(&(header.len() as u16).to_le_bytes())?;
        self.bytes(header.as_bytes())
    }

    fn floats(&mut self, numbers: &[f32]) -> Result<(), FormatError> {
        numbers.iter().try_for_each(|number| self.bytes(&number.to_le_bytes()))
    }

    fn bytes(&mut self, bytes: &[u8]) -> Result<(), FormatError> {
        Ok(self.zip.write_all(bytes).map_err(zip::result::ZipError::Io)?)
    }

    fn end(self) -> Result<Vec<u8>, FormatError> {
        Ok(self.zip.finish()?.into_inner())
    }
}
