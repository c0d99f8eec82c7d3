//! What each code of a model's pose VQ-VAE looks like (paper Fig. 7): a still pose per code, and the
//! change from one pair of codes to another, as figures and as numbers.

mod error;
mod facing;
mod figure;
mod page;
mod sheet;
mod still;
mod transition;
mod uses;

pub use error::CodebookError;
pub use sheet::Order;
pub use transition::Transition;
pub use uses::Uses;

use serde::Serialize;

use bailando_model::ModelDirectory;
use bailando_motion::{MotionFrame, Skeleton};
use still::StillPoses;

/// A half of the body with codes of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// From the lowest spine joint upwards.
    Upper,
    /// Pelvis and legs.
    Lower,
}

impl Half {
    /// `upper` or `lower`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Upper => "upper",
            Self::Lower => "lower",
        }
    }

    /// This half's part of something that is upper, then lower.
    fn of<T>(self, [upper, lower]: &[T; 2]) -> &T {
        match self {
            Self::Upper => upper,
            Self::Lower => lower,
        }
    }
}

/// Everything that is shown of a codebook; serialised, it is `codebook.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Catalogue {
    /// Name of the model.
    pub model: String,
    /// SHA-256 of its manifest.
    pub manifest_sha256: String,
    /// In the world's frame codes face different ways, in the dancer's all face +z.
    pub motion_frame: MotionFrame,
    /// Joints of the poses.
    pub skeleton: Skeleton,
    /// Codes of the upper half.
    pub upper: HalfCodes,
    /// Codes of the lower half.
    pub lower: HalfCodes,
    /// Changes from pair to pair.
    pub transitions: Vec<Transition>,
}

/// The codes of one half.
#[derive(Clone, Debug, Serialize)]
pub struct HalfCodes {
    /// Joints that this half decodes.
    pub joints: Vec<usize>,
    /// The code that is nearest to all others, whichever way they face: it stands in for this half
    /// where the other's codes are shown.
    pub neutral: u32,
    /// Every code, by number.
    pub codes: Vec<CodePose>,
}

/// One code.
#[derive(Clone, Debug, Serialize)]
pub struct CodePose {
    /// Its number.
    pub code: u32,
    /// Its still pose with the other half's neutral code, metres, the root at 0.
    pub pose: Vec<[f32; 3]>,
    /// How often the counted dances use it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uses: Option<u64>,
    /// The code that looks most like it; none where there is no other.
    pub nearest: Option<Nearest>,
}

/// Another code and how far its pose is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Nearest {
    /// Its number.
    pub code: u32,
    /// Mean distance of this half's joints but the root, metres.
    pub distance_m: f32,
}

impl Catalogue {
    /// Decodes every code of `directory`, with counts of `uses`, and at most `transitions` changes.
    ///
    /// # Errors
    /// [`CodebookError::Model`] or [`CodebookError::Motion`].
    pub fn new(
        directory: &ModelDirectory,
        threads: usize,
        uses: Option<&Uses>,
        transitions: usize,
    ) -> Result<Self, CodebookError> {
        let manifest = directory.manifest();
        let mut decoder = directory.decoder(threads)?;
        let poses = StillPoses::decode(&mut decoder, manifest)?;
        let mut transitions = transition::chosen(manifest, uses, transitions);
        transition::decode(&mut transitions, &mut decoder, manifest)?;
        let [upper, lower] = [Half::Upper, Half::Lower].map(|half| Likeness::of(&poses, half));
        let pose = |half, code| match half {
            Half::Upper => poses.body(code, lower.neutral),
            Half::Lower => poses.body(upper.neutral, code),
        };
        let half = |half, likeness: &Likeness, joints: &[usize]| HalfCodes {
            joints: joints.to_vec(),
            neutral: likeness.neutral as u32,
            codes: (0..poses.codes(half))
                .map(|code| CodePose {
                    code: code as u32,
                    pose: pose(half, code),
                    uses: uses.and_then(|uses| uses.of(half).get(code).copied()),
                    nearest: likeness.nearest.get(code).copied().flatten(),
                })
                .collect(),
        };
        Ok(Self {
            model: manifest.name.clone(),
            manifest_sha256: directory.manifest_sha256().to_owned(),
            motion_frame: manifest.motion_frame,
            skeleton: manifest.skeleton.clone(),
            upper: half(Half::Upper, &upper, &manifest.upper_joints),
            lower: half(Half::Lower, &lower, &manifest.lower_joints),
            transitions,
        })
    }

    /// The codes of one half.
    #[must_use]
    pub fn half(&self, half: Half) -> &HalfCodes {
        match half {
            Half::Upper => &self.upper,
            Half::Lower => &self.lower,
        }
    }
}

/// What the codes of a half are like, compared with each other.
struct Likeness {
    neutral: usize,
    nearest: Vec<Option<Nearest>>,
}

impl Likeness {
    fn of(poses: &StillPoses, half: Half) -> Self {
        let mut nearest = Vec::new();
        let mut neutral = (0, f32::INFINITY);
        for code in 0..poses.codes(half) {
            let total = poses.distances_from_front(half, code).iter().sum();
            if total < neutral.1 {
                neutral = (code, total);
            }
            let distances = poses.distances(half, code);
            let others = distances
                .iter()
                .enumerate()
                .filter(|&(other, _)| other != code);
            let best = others.min_by(|a, b| a.1.total_cmp(b.1));
            nearest.push(best.map(|(code, &distance_m)| Nearest {
                code: code as u32,
                distance_m,
            }));
        }
        Self {
            neutral: neutral.0,
            nearest,
        }
    }
}
