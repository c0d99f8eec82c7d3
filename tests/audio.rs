//! Audio: every accepted format, alignment between them, golden resampling, limits, bombs, damage.

mod common;
#[path = "audio/writers.rs"]
mod writers;

use std::{
    path::Path,
    time::{Duration, Instant},
};

use bailando::{
    CancelToken,
    audio::{self, AudioError, AudioLimits, AudioRange, DecodedAudio},
};
use bytes::Bytes;
use proptest::prelude::*;
use writers::{SilentFlac, wav, wav_declaring, wav16};

const LOW: u32 = 3_840;
const HIGH: u32 = 30_720;

fn fixture(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/audio");
    std::fs::read(path.join(name)).unwrap()
}

fn decode_part(
    bytes: impl Into<Bytes>,
    range: AudioRange,
    rates: &[u32],
) -> Result<DecodedAudio, AudioError> {
    let limits = AudioLimits::default();
    audio::decode(bytes.into(), range, rates, &limits, &CancelToken::new())
}

fn decode(bytes: impl Into<Bytes>, rates: &[u32]) -> Result<DecodedAudio, AudioError> {
    decode_part(bytes, AudioRange::default(), rates)
}

fn refusal(bytes: impl Into<Bytes>) -> AudioError {
    let error = decode(bytes, &[LOW]).expect_err("it should be refused");
    assert!(!error.to_string().is_empty());
    error
}

/// `n` samples of a tone that never repeats exactly.
fn tone(n: usize, rate: u32) -> Vec<i16> {
    (0..n)
        .map(|i| {
            let t = i as f64 / f64::from(rate);
            (9_000.0 * (2.0 * std::f64::consts::PI * (220.0 + 15.0 * t) * t).sin()) as i16
        })
        .collect()
}

fn npy(bytes: &[u8]) -> Vec<f32> {
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    assert!(
        bytes[10..10 + header]
            .windows(5)
            .any(|part| part == b"'<f4'")
    );
    bytes[10 + header..]
        .chunks_exact(4)
        .map(|four| f32::from_le_bytes(four.try_into().unwrap()))
        .collect()
}

/// Largest difference, and the RMS of the difference over the RMS of the reference.
fn difference(got: &[f32], reference: &[f32]) -> (f64, f64) {
    assert_eq!(got.len(), reference.len());
    let rms = |signal: &mut dyn Iterator<Item = f64>| {
        let (n, sum) = signal.fold((0_u32, 0.0), |(n, sum), x| (n + 1, sum + x * x));
        (sum / f64::from(n)).sqrt()
    };
    let errors = || got.iter().zip(reference).map(|(a, b)| f64::from(a - b));
    let largest = errors().fold(0.0, |max: f64, e| max.max(e.abs()));
    let reference = rms(&mut reference.iter().map(|&x| f64::from(x)));
    (largest, rms(&mut errors()) / reference)
}

mod formats {
    use super::*;

    #[test]
    fn all_five_decode_the_same_song() {
        let flac = decode(fixture("demo.flac"), &[LOW, HIGH]).unwrap();
        assert_eq!((flac.sample_rate, flac.channels), (32_000, 1));
        assert_eq!(flac.duration_s, 30.0);
        assert_eq!(flac.signals[0].len(), 30 * LOW as usize);
        assert_eq!(flac.signals[1].len(), 30 * HIGH as usize);
        assert_eq!(flac.warnings, Vec::<String>::new());
        for (name, rate, channels) in [
            ("demo.ogg", 32_000, 1),
            ("demo.mp3", 44_100, 2),
            ("demo.m4a", 44_100, 2),
        ] {
            let song = decode(fixture(name), &[LOW, HIGH]).unwrap();
            println!("{name}: {} s, {:?}", song.duration_s, song.warnings);
            assert_eq!(
                (song.sample_rate, song.channels),
                (rate, channels),
                "{name}"
            );
            assert_eq!(song.warnings, Vec::<String>::new(), "{name}");
            assert!(
                (song.duration_s - 30.0).abs() * f64::from(rate) < 1.5,
                "{name}"
            );
            let lag = lag(&song.signals[1], &flac.signals[1]);
            println!("{name}: lag {lag} samples at {HIGH} Hz");
            assert!(
                lag.abs() <= 31,
                "{name} is {lag} samples of 1/{HIGH} s late"
            );
        }
    }

    /// Samples by which `signal` is late against `reference`, by cross-correlation over 60 ms.
    fn lag(signal: &[f32], reference: &[f32]) -> i64 {
        const REACH: usize = 1_843;
        let part = REACH..reference.len().min(signal.len()) - REACH;
        let score = |shift: usize| -> f64 {
            let shifted = &signal[part.start + shift - REACH..part.end + shift - REACH];
            let products = shifted.iter().zip(&reference[part.clone()]);
            products.step_by(3).map(|(a, b)| f64::from(a * b)).sum()
        };
        let best = (0..=2 * REACH).max_by(|&a, &b| score(a).total_cmp(&score(b)));
        best.unwrap() as i64 - REACH as i64
    }
}
