//! The first pair of codes of a sequence.

use super::sampler::Sampler;

/// The start pair: given codes win; the rest is drawn as a pair from the manifest's list, or from
/// all that may be drawn when it has none. Both numbers are drawn always, so that giving one half
/// does not change the sequence's other draws.
pub(super) fn start_codes(
    given: [Option<u32>; 2],
    pairs: &[[u32; 2]],
    drawable: &[Vec<u32>; 2],
    sampler: &mut Sampler,
) -> [u32; 2] {
    let drawn = match pairs {
        [] => drawable.each_ref().map(|codes| codes[sampler.uniform(codes.len())]),
        pairs => pairs[sampler.uniform(pairs.len())],
    };
    [0, 1].map(|half| given[half].unwrap_or(drawn[half]))
}

#[cfg(test)]
mod tests {
    use super::{super::sampler::Sampling, *};

    #[test]
    fn starts_are_drawn_from_pairs_or_from_what_may_be_drawn() {
        let sampling = Sampling { temperature: 1.0, top_k: None };
        let mut sampler = Sampler::new(sampling, 3);
        let drawable = [vec![4], vec![1, 9]];
        let mut seen = [0; 2];
        for _ in 0..50 {
            let [upper, lower] = start_codes([None; 2], &[], &drawable, &mut sampler);
            assert!(upper == 4 && [1, 9].contains(&lower));
            seen[usize::from(lower == 9)] += 1;
        }
        assert!(seen.iter().all(|&count| count > 5), "{seen:?}");
        let given = start_codes([None, Some(7)], &[[2, 3]], &drawable, &mut sampler);
        assert_eq!(given, [2, 7]);
    }
}
