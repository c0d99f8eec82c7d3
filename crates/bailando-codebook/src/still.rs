//! The still pose of every code: a code that is repeated decodes to one (ARCHITECTURE section 7).

use ndarray::{ArrayView1, Axis, Slice};

use super::{CodebookError, Half, facing::halves_to_front};
use bailando_model::{Decoder, Manifest};

/// x, y and z of every joint in metres, the root at 0.
pub(super) type Pose = Vec<[f32; 3]>;

/// How often a code is repeated: its middle is far from the zero padding at the ends.
const REPEATS: usize = 12;
/// Runs that are decoded at once.
const BATCH: usize = 16;

/// A body whose joints of either half are those of each code in turn. The halves are decoded
/// independently of each other, so one run tells of an upper and of a lower code.
pub(super) struct StillPoses {
    bodies: Vec<Pose>,
    /// The same, each half facing +z.
    fronts: Vec<Pose>,
    joints: [Vec<usize>; 2],
    codes: [usize; 2],
}

impl StillPoses {
    pub(super) fn decode(
        decoder: &mut Decoder,
        manifest: &Manifest,
    ) -> Result<Self, CodebookError> {
        let codes = [manifest.vocabulary.upper, manifest.vocabulary.lower];
        let runs: Vec<usize> = (0..codes[0].max(codes[1])).collect();
        let middle = REPEATS * manifest.frames_per_code / 2;
        let mut bodies = Vec::with_capacity(runs.len());
        for batch in runs.chunks(BATCH) {
            let repeated = |&run: &usize| {
                // The shorter vocabulary's last code is decoded again and never looked at.
                let pair = codes.map(|codes| run.min(codes.saturating_sub(1)) as u32);
                [pair; REPEATS]
            };
            let repeated: Vec<_> = batch.iter().map(repeated).collect();
            let sequences: Vec<_> = repeated.iter().map(|codes| &codes[..]).collect();
            let motion = decoder.decode_batch(&sequences)?;
            bodies.extend(motion.outer_iter().map(|run| {
                let frame = run.slice_axis(Axis(0), Slice::from(middle..=middle));
                pose(frame.index_axis(Axis(0), 0), manifest.skeleton.joints.len())
            }));
        }
        let joints = [manifest.upper_joints.clone(), manifest.lower_joints.clone()];
        let [upper, _] = &joints;
        let fronts = bodies.iter().map(|body| halves_to_front(body, upper).0);
        Ok(Self {
            fronts: fronts.collect(),
            bodies,
            joints,
            codes,
        })
    }

    /// Number of codes of a half.
    pub(super) fn codes(&self, half: Half) -> usize {
        half.of(&self.codes).to_owned()
    }

    /// A body of one upper and one lower code; as [`Pose`].
    pub(super) fn body(&self, upper: usize, lower: usize) -> Pose {
        let mut body = self.bodies.get(lower).cloned().unwrap_or_default();
        if let Some(other) = self.bodies.get(upper) {
            for &joint in Half::Upper.of(&self.joints) {
                if let (Some(place), Some(from)) = (body.get_mut(joint), other.get(joint)) {
                    *place = *from;
                }
            }
        }
        body
    }

    /// Distances of every code of a half to one of them: the mean over the half's joints, metres.
    pub(super) fn distances(&self, half: Half, code: usize) -> Vec<f32> {
        self.apart(&self.bodies, half, code)
    }

    /// As [`Self::distances`], but with every pose facing +z.
    pub(super) fn distances_from_front(&self, half: Half, code: usize) -> Vec<f32> {
        self.apart(&self.fronts, half, code)
    }

    fn apart(&self, bodies: &[Pose], half: Half, code: usize) -> Vec<f32> {
        // The root is at 0 in every pose.
        let joints: Vec<usize> = half
            .of(&self.joints)
            .iter()
            .copied()
            .filter(|&j| j != 0)
            .collect();
        let at = |code: usize, joint: usize| -> [f32; 3] {
            let body = bodies.get(code);
            body.and_then(|body| body.get(joint))
                .copied()
                .unwrap_or_default()
        };
        let apart = |other: usize| {
            let lengths = joints.iter().map(|&joint| {
                let pairs = at(code, joint).into_iter().zip(at(other, joint));
                pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
            });
            lengths.sum::<f32>() / joints.len().max(1) as f32
        };
        (0..self.codes(half)).map(apart).collect()
    }
}

/// The joints of one decoded frame. What the root does next, and a turn, are no part of a pose.
pub(super) fn pose(columns: ArrayView1<'_, f32>, joints: usize) -> Pose {
    let column = |index: usize| columns.get(index).copied().unwrap_or_default();
    (0..joints)
        .map(|joint| match joint {
            0 => [0.0; 3],
            _ => std::array::from_fn(|axis| column(3 * joint + axis)),
        })
        .collect()
}
