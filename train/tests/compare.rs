//! `compare`: a model beside the same with quantised weights.

use crate::common::imported;
use crate::testing::TestFolder;
use bailando::model::WeightStorage;
use bailando_testkit::model::tiny;
use bailando_train::{
    compare::{CompareOptions, Comparison, compare},
    data::Split,
    export::skeleton,
    held_out::Recordings,
};

fn compared(weights: WeightStorage) -> Comparison {
    let (other, _) = imported(|options| options.description.weights = weights);
    let (data, cache) = (TestFolder::good(&skeleton(0.93)), tempfile::tempdir().unwrap());
    let options = CompareOptions {
        original: tiny(),
        model: other.path().join("model"),
        recordings: Recordings {
            data: data.write().to_owned(),
            audio: None,
            cache: Some(cache.path().to_owned()),
            split: Split::Train,
        },
    };
    compare(&options).unwrap()
}

#[test]
fn a_copy_is_equal_and_eight_bits_are_nearly() {
    let copy = compared(WeightStorage::F32);
    // Windows of a block of 29 that fit into 75 codes, in each of three pieces, two halves.
    assert_eq!(copy.codes, 3 * 2 * 29 * 2);
    assert_eq!((copy.same_likeliest, copy.same_drawn), (1.0, 1.0));
    assert_eq!(copy.perplexity, copy.perplexity_of_original);
    assert_eq!(copy.bytes, copy.bytes_of_original);

    let small = compared(WeightStorage::Int8);
    assert!(2 * small.bytes < small.bytes_of_original);
    assert!(small.divergence > 0.0 && small.divergence < 0.1, "{small}");
    assert!(small.same_likeliest > 0.5 && small.same_drawn > 0.5, "{small}");
    assert!(small.same_drawn < 1.0, "{small}");
    assert!(small.to_string().contains("are drawn by both"), "{small}");
}
