//! The still pose of every code: a repeated code decodes to one (ARCHITECTURE section 7).

use ndarray::Array2;

use crate::{
    error::CodebookError,
    half::Half,
    heading::halves_to_front,
    pose::{Pose, pose},
};
use bailando_core::CancelToken;
use bailando_model::{Decoder, Manifest};

/// How often a code is repeated: its middle is far from the zero padding at the ends.
const REPEATS: usize = 12;
/// Runs that are decoded at once.
const BATCH: usize = 16;

/// Bodies whose joints of either half are those of each code in turn. The halves are decoded
/// independently of each other, so one run shows an upper and a lower code.
pub(crate) struct StillPoses {
    bodies: Vec<Pose>,
    /// The same, each half turned towards +z.
    fronts: Vec<Pose>,
    joints: [Vec<usize>; 2],
    codes: [usize; 2],
}

impl StillPoses {
    pub(crate) fn decode(
        decoder: &mut Decoder,
        manifest: &Manifest,
    ) -> Result<Self, CodebookError> {
        let codes = [manifest.vocabulary.upper, manifest.vocabulary.lower];
        let runs: Vec<usize> = (0..codes[0].max(codes[1])).collect();
        let middle = REPEATS * manifest.frames_per_code / 2;
        let mut bodies = Vec::with_capacity(runs.len());
        for batch in runs.chunks(BATCH) {
            let repeated = |codes: usize| {
                // The shorter vocabulary's last code is decoded again, and that is never used.
                let code = |run: usize| batch[run].min(codes.saturating_sub(1)) as u32;
                Array2::from_shape_fn((batch.len(), REPEATS), |(run, _)| code(run))
            };
            let [upper, lower] = codes.map(repeated);
            let never = CancelToken::new();
            let motion = decoder.decode_batch(upper.view(), lower.view(), &never)?;
            let joints = manifest.skeleton.joints.len();
            bodies.extend(motion.outer_iter().map(|run| pose(run.row(middle), joints)));
        }
        let upper = &manifest.upper_joints;
        let fronts = bodies.iter().map(|body| halves_to_front(body, upper).0);
        Ok(Self {
            fronts: fronts.collect(),
            bodies,
            joints: [upper.clone(), manifest.lower_joints.clone()],
            codes,
        })
    }

    /// Number of codes of a half.
    pub(crate) fn codes(&self, half: Half) -> usize {
        *half.of(&self.codes)
    }

    /// Joints that a half decodes.
    pub(crate) fn joints(&self, half: Half) -> &[usize] {
        half.of::<Vec<usize>>(&self.joints)
    }

    /// Returns the body of one upper and one lower code.
    pub(crate) fn body(&self, [upper, lower]: [usize; 2]) -> Pose {
        let mut body = self.bodies[lower].clone();
        for &joint in self.joints(Half::Upper) {
            body[joint] = self.bodies[upper][joint];
        }
        body
    }

    /// Distances of every code of a half to one of them: the mean over the half's joints, metres.
    pub(crate) fn distances(&self, half: Half, code: usize) -> Vec<f32> {
        self.apart(&self.bodies, half, code)
    }

    /// As [`Self::distances`], with every pose turned towards +z.
    pub(crate) fn distances_from_front(&self, half: Half, code: usize) -> Vec<f32> {
        self.apart(&self.fronts, half, code)
    }

    fn apart(&self, bodies: &[Pose], half: Half, code: usize) -> Vec<f32> {
        // The root is at 0 in every pose.
        let joints = || self.joints(half).iter().filter(|&&joint| joint != 0);
        let apart = |other: usize| {
            let lengths = joints().map(|&joint| {
                let pairs = bodies[code][joint].into_iter().zip(bodies[other][joint]);
                pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
            });
            lengths.sum::<f32>() / joints().count().max(1) as f32
        };
        (0..self.codes(half)).map(apart).collect()
    }
}
