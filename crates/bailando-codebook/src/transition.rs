//! How one pose becomes another: a pair of codes, then another pair.

use ndarray::Axis;
use serde::Serialize;

use super::{
    CodebookError, Uses,
    still::{Pose, pose},
    uses::Pair,
};
use bailando_model::{Decoder, Manifest};

/// How often either pair is repeated, so that both are poses before and after the change.
const REPEATS: usize = 6;
/// Poses that are shown of a change.
pub(super) const POSES: usize = 9;
/// Poses that are shown of each code.
const POSES_PER_CODE: usize = 2;

/// A change from one pair of codes (upper, lower) to another.
#[derive(Clone, Debug, Serialize)]
pub struct Transition {
    /// The pair before.
    pub from: Pair,
    /// The pair after.
    pub to: Pair,
    /// How often the counted dances do this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uses: Option<u64>,
    /// The change itself, evenly spaced in time.
    #[serde(skip)]
    pub(super) poses: Vec<Pose>,
}

/// The changes worth showing, at most `most`: the most frequent of the counted dances, else those
/// between the model's start codes one after another, else between pairs drawn evenly from the
/// vocabulary.
pub(super) fn chosen(manifest: &Manifest, uses: Option<&Uses>, most: usize) -> Vec<Transition> {
    let transition = |from, to, uses| Transition {
        from,
        to,
        uses,
        poses: Vec::new(),
    };
    if let Some(uses) = uses {
        let changes = uses.changes(most).into_iter();
        return changes
            .map(|([from, to], uses)| transition(from, to, Some(uses)))
            .collect();
    }
    let pairs = match manifest.start_codes.as_slice() {
        [] | [_] => evenly(manifest, most),
        pairs => pairs.to_vec(),
    };
    let next = pairs.iter().cycle().skip(1);
    let changes = pairs.iter().zip(next).filter(|(from, to)| from != to);
    changes
        .take(most)
        .map(|(&from, &to)| transition(from, to, None))
        .collect()
}

fn evenly(manifest: &Manifest, count: usize) -> Vec<Pair> {
    let vocabulary = manifest.vocabulary;
    let count = count.clamp(2, vocabulary.upper.max(vocabulary.lower).max(2));
    let code = |index: usize, codes: usize| (index * codes / count) as u32;
    (0..count)
        .map(|index| [code(index, vocabulary.upper), code(index, vocabulary.lower)])
        .collect()
}

/// Decodes what `transitions` look like.
pub(super) fn decode(
    transitions: &mut [Transition],
    decoder: &mut Decoder,
    manifest: &Manifest,
) -> Result<(), CodebookError> {
    if transitions.is_empty() {
        return Ok(());
    }
    let changes = transitions.iter();
    let codes = changes.map(|change| [[change.from; REPEATS], [change.to; REPEATS]].concat());
    let codes: Vec<Vec<_>> = codes.collect();
    let sequences: Vec<_> = codes.iter().map(Vec::as_slice).collect();
    let motion = decoder.decode_batch(&sequences)?;
    let step = manifest.frames_per_code / POSES_PER_CODE;
    let first = (REPEATS * manifest.frames_per_code).saturating_sub(POSES / 2 * step);
    for (transition, decoded) in transitions.iter_mut().zip(motion.outer_iter()) {
        let world = manifest.motion_frame.into_world(decoded.to_owned())?;
        let frames = world.axis_iter(Axis(0)).skip(first).step_by(step.max(1));
        let joints = manifest.skeleton.joints.len();
        transition.poses = frames
            .take(POSES)
            .map(|frame| pose(frame, joints))
            .collect();
    }
    Ok(())
}
