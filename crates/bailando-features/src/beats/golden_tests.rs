//! The stages against golden values of madmom's chain and decoder, on music of our own.

use bailando_testkit::{arrays, fixture};
use ndarray::{Array1, Array2, Axis, Slice};

use super::{
    counts::counts_of,
    decode::Decoder,
    hmm::{Activation, Beat},
    spectrogram::Spectrogram,
};

fn activations(song: &str) -> Vec<Activation> {
    let columns = arrays::floats(&fixture(format!("beats/{song}_activations.npy")));
    let rows = columns.rows().into_iter();
    rows.map(|row| Activation { beat: row[0], downbeat: row[1] }).collect()
}

#[test]
fn rows_are_those_of_the_reference() {
    let pcm = arrays::load::<f32, ndarray::Ix1>(&fixture("beats/demo_pcm_22050.npy"));
    let expected = arrays::floats(&fixture("beats/demo_features.npy"));
    let rows = Spectrogram::new().rows(&pcm.to_vec(), 1.0, 0..expected.nrows());
    arrays::assert_close(&rows, &expected, 1e-5, "spectrogram");
    let rises = expected.slice_axis(Axis(1), Slice::from(136..));
    assert!(rises.iter().any(|&rise| rise > 0.5), "the excerpt has onsets");
}

/// The same frames and numbers in bars as madmom's decoder, at its own settings and at those of
/// 65 to 130 beats a minute in bars of three or four.
#[test]
fn beats_are_those_of_the_reference() {
    let decoders =
        [("wheel_dbn", Decoder::of(&[2, 3, 4], 14, 55)), ("half34", Decoder::of(&[3, 4], 23, 46))];
    for song in ["demo", "m04_a", "waltz"] {
        for (name, decoder) in &decoders {
            let file = fixture(format!("beats/{song}_beats_{name}.npy"));
            let expected: Array2<f64> = arrays::load(&file);
            let beat = |row: ndarray::ArrayView1<'_, f64>| Beat {
                frame: (row[0] * 50.0).round() as usize,
                number: row[1] as usize,
            };
            let expected: Vec<Beat> = expected.rows().into_iter().map(beat).collect();
            let (beats, metre) = decoder.beats(&activations(song));
            assert_eq!(beats, expected, "{song} {name}");
            let bars = expected.iter().map(|beat| beat.number).max();
            assert_eq!(Some(metre), bars, "{song} {name}");
        }
    }
}

#[test]
fn counts_are_those_of_the_reference() {
    for song in ["demo", "m04_a"] {
        let load = |what: &str| fixture(format!("beats/{song}_{what}.npy"));
        let beats: Array2<f64> = arrays::load(&load("beats_half34"));
        let expected: Array1<f64> = arrays::load(&load("counts_s"));
        let counts = counts_of(&beats.column(0).to_vec());
        assert_eq!(counts.len(), expected.len(), "{song}");
        let differences = counts.iter().zip(&expected).map(|(a, b)| (a - b).abs());
        assert!(differences.fold(0.0, f64::max) < 1e-9, "{song}");
    }
}
