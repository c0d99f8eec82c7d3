//! Where dances begin and end on the floor, and what another dance must know to go on from one.

use super::{GenerationOptions, worker::Outcome};
use crate::{
    formats::{Codes, Continuation},
    model::ModelDirectory,
};

/// Most pose codes in a tail, so that it fits into the value of an option.
const LONGEST_TAIL: usize = 43;
/// Largest vocabulary whose codes a tail can hold.
const MOST_TAIL_CODES: usize = 1 << 16;

/// Where the root starts on the floor.
pub(super) fn start_of(options: &GenerationOptions) -> [f32; 2] {
    let tail = options.continue_from.as_ref();
    tail.map_or([0.0; 2], |tail| tail.position)
}

/// Where the root goes next on the floor: a dancer that is held in place is held at 0, wherever the dance
/// before it ended.
fn place_after(outcome: &Outcome, options: &GenerationOptions) -> [f32; 2] {
    if !options.root_motion {
        return [0.0; 2];
    }
    let [x, z] = start_of(options);
    let [walked_x, walked_z] = outcome.walked;
    [x + walked_x, z + walked_z]
}

/// The end of a dance of `directory`'s model; none if a tail cannot hold its codes.
pub(super) fn tail_of(
    outcome: &Outcome,
    options: &GenerationOptions,
    directory: &ModelDirectory,
) -> Option<Continuation> {
    let manifest = directory.manifest();
    let vocabulary = manifest.vocabulary;
    if vocabulary.upper.max(vocabulary.lower) > MOST_TAIL_CODES {
        return None;
    }
    let count = (manifest.decoder.receptive_codes + 1).min(LONGEST_TAIL);
    let before = options.continue_from.as_ref().map(|tail| &tail.codes);
    let codes = last_codes(before, &outcome.codes, count);
    let place = place_after(outcome, options);
    let facing = outcome.facing;
    Some(Continuation::new(
        directory.manifest_sha256(),
        codes,
        place,
        facing,
    ))
}

/// The last `count` codes of a dance, and of the one that it goes on from where it is short itself.
fn last_codes(before: Option<&Codes>, own: &Codes, count: usize) -> Codes {
    let half = |of: fn(&Codes) -> &Vec<u32>| -> Vec<u32> {
        let before = before.map_or(&[][..], |codes| of(codes));
        let all = before.iter().chain(of(own));
        let length = before.len() + of(own).len();
        all.skip(length.saturating_sub(count)).copied().collect()
    };
    Codes {
        upper: half(|codes| &codes.upper),
        lower: half(|codes| &codes.lower),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ndarray::Array2;

    use super::*;

    fn codes(upper: [u32; 2]) -> Codes {
        Codes {
            upper: upper.to_vec(),
            lower: upper.map(|code| code + 100).to_vec(),
        }
    }

    fn walked(walked: [f32; 2]) -> Outcome {
        Outcome {
            codes: codes([1, 2]),
            motion: Array2::zeros((0, 72)),
            walked,
            facing: 0.0,
            queued: Duration::ZERO,
            inference: Duration::ZERO,
        }
    }

    #[test]
    fn a_dance_ends_where_it_walked_to_or_where_it_was_held() {
        let before = Continuation::new("00000000", codes([1, 2]), [3.0, -2.0], 0.0);
        for (root_motion, expected) in [(true, [3.5, -1.0]), (false, [0.0, 0.0])] {
            let options = GenerationOptions {
                continue_from: Some(before.clone()),
                root_motion,
                ..GenerationOptions::default()
            };
            assert_eq!(place_after(&walked([0.5, 1.0]), &options), expected);
        }
    }

    #[test]
    fn a_short_dance_leaves_the_codes_before_it_as_well() {
        let (before, own) = (codes([1, 2]), codes([3, 4]));
        let last = |count| last_codes(Some(&before), &own, count).upper;
        assert_eq!(last(3), [2, 3, 4]);
        assert_eq!(last(1), [4]);
        assert_eq!(last(9), [1, 2, 3, 4]);
        assert_eq!(last_codes(None, &own, 9).lower, [103, 104]);
    }
}
