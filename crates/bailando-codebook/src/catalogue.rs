//! All codes of a model as numbers.

use serde::Serialize;

use crate::{
    error::CodebookError,
    half::Half,
    still::StillPoses,
    transition::{self, Transition},
    uses::Uses,
};
use bailando_model::ModelDirectory;
use bailando_motion::{MotionFrame, Skeleton};

/// Every code of a model; serialised, it is `codebook.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Catalogue {
    /// Name of the model.
    pub model: String,
    /// SHA-256 of its manifest.
    pub manifest_sha256: String,
    /// In the world's frame codes have different headings, in the dancer's all head for +z.
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
    /// The code nearest to all others, headings aside: it stands in for this half where codes of
    /// the other half are shown.
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
    /// How often the counted motions use it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uses: Option<u64>,
    /// The code that looks most like it; none where there is no other.
    pub nearest: Option<Nearest>,
}

/// Another code and the distance of its pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Nearest {
    /// Its number.
    pub code: u32,
    /// Mean distance of this half's joints except the root, metres.
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
        let neutral = Half::BOTH.map(|half| neutral(&poses, half));
        let [upper, lower] = Half::BOTH.map(|half| {
            let code_pose = |code: usize| CodePose {
                code: code as u32,
                pose: match half {
                    Half::Upper => poses.body([code, neutral[1]]),
                    Half::Lower => poses.body([neutral[0], code]),
                },
                uses: uses.and_then(|uses| uses.of(half).get(code).copied()),
                nearest: nearest(&poses, half, code),
            };
            HalfCodes {
                joints: poses.joints(half).to_vec(),
                neutral: *half.of(&neutral) as u32,
                codes: (0..poses.codes(half)).map(code_pose).collect(),
            }
        });
        Ok(Self {
            model: manifest.name.clone(),
            manifest_sha256: directory.manifest_sha256().to_owned(),
            motion_frame: manifest.motion_frame,
            skeleton: manifest.skeleton.clone(),
            upper,
            lower,
            transitions,
        })
    }

    /// The codes of one half.
    #[must_use]
    pub const fn half(&self, half: Half) -> &HalfCodes {
        match half {
            Half::Upper => &self.upper,
            Half::Lower => &self.lower,
        }
    }
}

fn neutral(poses: &StillPoses, half: Half) -> usize {
    let total = |code| -> f32 { poses.distances_from_front(half, code).iter().sum() };
    let totals = (0..poses.codes(half)).map(|code| (code, total(code)));
    totals.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(code, _)| code)
}

fn nearest(poses: &StillPoses, half: Half, code: usize) -> Option<Nearest> {
    let distances = poses.distances(half, code).into_iter().enumerate();
    let others = distances.filter(|&(other, _)| other != code);
    let (code, distance_m) = others.min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(Nearest { code: code as u32, distance_m })
}
