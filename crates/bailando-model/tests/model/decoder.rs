//! Decoder and encoder against the golden vectors, and how far a code reaches.

use bailando_model::{Decoder, code_pairs};
use bailando_testkit::arrays::{assert_close, codes, floats, rows};
use ndarray::{Array2, Axis, concatenate};

use crate::{SAMPLINGS, TOLERANCE, directory, golden};

#[test]
fn motion_and_codes_are_golden() {
    let directory = directory();
    let mut decoder = directory.decoder(1).unwrap();
    for sampling in SAMPLINGS {
        let motion = decoder.decode(&sampling.codes()).unwrap();
        assert_close(&motion, &floats(&golden(sampling.motion)), TOLERANCE, sampling.motion);
    }
    let motion = floats(&golden("motion.npy"));
    let encoded = directory.encoder(1).unwrap().encode(motion.view()).unwrap();
    let [upper, lower] = ["enc_up.npy", "enc_down.npy"].map(|name| codes(&golden(name)));
    assert_eq!(encoded, code_pairs(&upper, &lower).unwrap());
}

/// Decodes in chunks of `length` codes with `overlap` codes on either side, and joins the middles.
fn decode_chunked(
    decoder: &mut Decoder,
    codes: &[[u32; 2]],
    length: usize,
    overlap: usize,
) -> Array2<f32> {
    let mut parts = Vec::new();
    for start in (0..codes.len()).step_by(length) {
        let end = (start + length).min(codes.len());
        let from = start.saturating_sub(overlap);
        let to = (end + overlap).min(codes.len());
        let chunk = decoder.decode(&codes[from..to]).unwrap();
        parts.push(rows(&chunk, 8 * (start - from)..8 * (end - from)).to_owned());
    }
    let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
    concatenate(Axis(0), &views).unwrap()
}

#[test]
fn chunks_that_overlap_by_the_receptive_field_decode_as_the_whole() {
    let directory = directory();
    let overlap = directory.manifest().decoder.receptive_codes;
    // Three blocks of dilations 1, 3, 9 at three rates, and the two outer convolutions.
    assert_eq!(overlap, 25);
    let mut decoder = directory.decoder(1).unwrap();
    let codes = SAMPLINGS[0].codes().repeat(3);
    let whole = decoder.decode(&codes).unwrap();
    for length in [7, 40, 64] {
        let chunked = decode_chunked(&mut decoder, &codes, length, overlap);
        assert_close(&chunked, &whole, TOLERANCE, &format!("chunks of {length}"));
    }
    let careless = decode_chunked(&mut decoder, &codes, 40, 1);
    let difference = (&careless - &whole).mapv(f32::abs);
    assert!(difference.iter().any(|&d| d > 1e-3), "an overlap of 1 would do");
}

#[test]
fn a_code_moves_frames_within_the_receptive_field_only() {
    let directory = directory();
    let reach = directory.manifest().decoder.receptive_codes;
    let mut decoder = directory.decoder(1).unwrap();
    let changed_code = 40;
    let codes = vec![[3; 2]; 80];
    let mut moved = codes.clone();
    moved[changed_code] = [9; 2];
    let [before, after] = [&codes, &moved].map(|codes| decoder.decode(codes).unwrap());
    let moved: Vec<usize> = (0..80)
        .filter(|code| {
            let frames = 8 * code..8 * code + 8;
            rows(&before, frames.clone()) != rows(&after, frames)
        })
        .collect();
    let (first, last) = (moved[0], moved[moved.len() - 1]);
    // Exactly: a smaller overlap would not do, a larger one would be wasted.
    assert_eq!((first, last), (changed_code - reach, changed_code + reach));
}
