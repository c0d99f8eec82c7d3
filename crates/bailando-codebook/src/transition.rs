//! The change from one pair of codes to another.

use ndarray::Axis;
use serde::Serialize;

use crate::{
    error::CodebookError,
    pose::{Pose, pose},
    uses::{Pair, Uses},
};
use bailando_model::{Decoder, Manifest};

/// How often either pair is repeated, so that both are poses before and after the change.
const REPEATS: usize = 6;
/// Poses that are shown of a change.
pub(crate) const POSES: usize = 9;
/// Poses that are shown of each code.
const POSES_PER_CODE: usize = 2;

/// A change from one pair of codes (upper, lower) to another.
#[derive(Clone, Debug, Serialize)]
pub struct Transition {
    /// The pair before.
    pub from: Pair,
    /// The pair after.
    pub to: Pair,
    /// How often the counted motions contain it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uses: Option<u64>,
    /// Poses of the change, evenly spaced in time.
    #[serde(skip)]
    pub(crate) poses: Vec<Pose>,
}

impl Transition {
    fn new(from: Pair, to: Pair, uses: Option<u64>) -> Self {
        Self { from, to, uses, poses: Vec::new() }
    }
}

/// Chooses at most `most` changes: the most frequent of the counted motions, else those between
/// the model's start codes in their order, else between pairs drawn evenly from the vocabulary.
pub(crate) fn chosen(manifest: &Manifest, uses: Option<&Uses>, most: usize) -> Vec<Transition> {
    if let Some(uses) = uses {
        let changes = uses.changes(most).into_iter();
        return changes.map(|([from, to], uses)| Transition::new(from, to, Some(uses))).collect();
    }
    let pairs = match manifest.start_codes.as_slice() {
        [] | [_] => evenly(manifest, most),
        pairs => pairs.to_vec(),
    };
    let next = pairs.iter().cycle().skip(1);
    let changes = pairs.iter().zip(next).filter(|(from, to)| from != to);
    let changes = changes.map(|(&from, &to)| Transition::new(from, to, None));
    changes.take(most).collect()
}

fn evenly(manifest: &Manifest, count: usize) -> Vec<Pair> {
    let vocabulary = manifest.vocabulary;
    let count = count.clamp(2, vocabulary.upper.max(vocabulary.lower).max(2));
    let code = |index: usize, codes: usize| (index * codes / count) as u32;
    (0..count)
        .map(|index| [vocabulary.upper, vocabulary.lower].map(|codes| code(index, codes)))
        .collect()
}

/// Decodes the poses of `transitions`.
pub(crate) fn decode(
    transitions: &mut [Transition],
    decoder: &mut Decoder,
    manifest: &Manifest,
) -> Result<(), CodebookError> {
    if transitions.is_empty() {
        return Ok(());
    }
    let changes = transitions.iter();
    let codes = changes.map(|change| [[change.from; REPEATS], [change.to; REPEATS]].concat());
    let codes: Vec<Vec<Pair>> = codes.collect();
    let sequences: Vec<_> = codes.iter().map(Vec::as_slice).collect();
    let motion = decoder.decode_batch(&sequences)?;
    let step = manifest.frames_per_code / POSES_PER_CODE;
    let first = (REPEATS * manifest.frames_per_code).saturating_sub(POSES / 2 * step);
    let joints = manifest.skeleton.joints.len();
    for (transition, decoded) in transitions.iter_mut().zip(motion.outer_iter()) {
        let world = manifest.motion_frame.into_world(decoded.to_owned())?;
        let frames = world.axis_iter(Axis(0)).skip(first).step_by(step.max(1));
        let poses = frames.take(POSES).map(|frame| pose(frame, joints));
        transition.poses = poses.collect();
    }
    Ok(())
}
