//! Audio: every accepted format, alignment between them, golden resampling, limits, bombs, damage.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::large_stack_arrays,
    reason = "tests stop where something is not as it should be, and say what they measured"
)]

use std::time::{Duration, Instant};

use bailando_audio::{self as audio, AudioError, AudioLimits, AudioRange, DecodedAudio};
use bailando_core::CancelToken;
use bailando_testkit::{
    song as fixture,
    wav::{SilentFlac, wav, wav_declaring, wav16},
};
use bytes::Bytes;
use proptest::prelude::*;

const LOW: u32 = 3_840;
const HIGH: u32 = 30_720;

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
    assert!(bytes[10..10 + header].windows(5).any(|part| part == b"'<f4'"));
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
    fn all_decode_the_same_song() {
        let flac = decode(fixture("demo.flac"), &[LOW, HIGH]).unwrap();
        assert_eq!((flac.sample_rate, flac.channels), (32_000, 1));
        assert_eq!(flac.duration_s, 30.0);
        assert_eq!(flac.signals[0].len(), 30 * LOW as usize);
        assert_eq!(flac.signals[1].len(), 30 * HIGH as usize);
        assert_eq!(flac.warnings, Vec::<String>::new());
        for (name, rate, channels) in
            [("demo.ogg", 32_000, 1), ("demo.mp3", 44_100, 2), ("demo.m4a", 44_100, 2)]
        {
            let song = decode(fixture(name), &[LOW, HIGH]).unwrap();
            println!("{name}: {} s, {:?}", song.duration_s, song.warnings);
            assert_eq!((song.sample_rate, song.channels), (rate, channels), "{name}");
            assert_eq!(song.warnings, Vec::<String>::new(), "{name}");
            assert!((song.duration_s - 30.0).abs() * f64::from(rate) < 1.5, "{name}");
            let lag = lag(&song.signals[1], &flac.signals[1]);
            println!("{name}: lag {lag} samples at {HIGH} Hz");
            assert!(lag.abs() <= 31, "{name} is {lag} samples of 1/{HIGH} s late");
        }
    }

    /// Samples by which `signal` is late against `reference`, by cross-correlation over 60 ms.
    fn lag(signal: &[f32], reference: &[f32]) -> i64 {
        const REACH: usize = 1_843;
        let part = 5 * 30_720..8 * 30_720;
        let score = |shift: usize| -> f64 {
            let shifted = &signal[part.start + shift - REACH..part.end + shift - REACH];
            let products = shifted.iter().zip(&reference[part.clone()]);
            products.step_by(3).map(|(a, b)| f64::from(a * b)).sum()
        };
        let best = (0..=2 * REACH).max_by(|&a, &b| score(a).total_cmp(&score(b)));
        best.unwrap() as i64 - REACH as i64
    }
}

#[test]
fn a_wav_is_the_same_signal_as_the_flac_it_was_made_from() {
    let flac = decode(fixture("demo.flac"), &[32_000]).unwrap();
    let samples: Vec<i16> =
        flac.signals[0].iter().map(|&sample| (sample * 32_768.0) as i16).collect();
    let stereo: Vec<i16> = samples.iter().flat_map(|&s| [s, s]).collect();
    for (channels, samples) in [(1, &samples), (2, &stereo)] {
        let wav = decode(wav16(channels, 32_000, samples), &[32_000, LOW]).unwrap();
        assert_eq!(wav.signals[0], flac.signals[0]);
        assert_eq!(wav.signals[1].len(), 30 * LOW as usize);
        assert_eq!(wav.channels, usize::from(channels));
        assert_eq!(wav.duration_s, 30.0);
    }
}

#[test]
fn integers_are_scaled_by_full_scale_and_channels_averaged() {
    let mut samples = vec![0_i16; 2 * 8_000];
    samples[..6].copy_from_slice(&[i16::MIN, i16::MIN, 16_384, 0, 1, -1]);
    let song = decode(wav16(2, 8_000, &samples), &[8_000]).unwrap();
    assert_eq!(song.signals[0][..4], [-1.0, 0.25, 0.0, 0.0]);
    let bytes: Vec<u8> = [0, 128, 192].into_iter().chain([128; 8_000]).collect();
    let song = decode(wav(1, 8_000, 8, &bytes), &[8_000]).unwrap();
    assert_eq!(song.signals[0][..4], [-1.0, 0.0, 0.5, 0.0]);
}

mod golden {
    use super::*;

    #[test]
    fn eight_seconds_at_the_conditioning_rate() {
        let reference = npy(&fixture("demo_44k1_8s_at_3840.npy"));
        let song = decode(fixture("demo_44k1_8s.wav"), &[LOW, 44_100]).unwrap();
        let got = &song.signals[0];
        // The excerpt starts in the middle of a wave. There soxr drops what its first stage gives
        // before time zero, which moves its very first output by 6.7e-4; with silence in front it
        // agrees with the definition (outside the file is zero) to 5e-7. So that one sample is
        // held to the definition, and all others to soxr.
        let (largest, _) = difference(&got[1..], &reference[1..]);
        let (_, ratio) = difference(got, &reference);
        println!("8 s at {LOW}: largest {largest:e}, RMS ratio {ratio:e}");
        assert!(largest < 5e-4, "{largest}");
        assert!(ratio < 1e-4, "{ratio}");
        let mut padded = vec![0.0; 735 * 20];
        padded.extend(&song.signals[1]);
        let later = audio::resample(&padded, 44_100, LOW);
        assert_eq!(later[64 * 20], got[0]);
    }

    #[test]
    fn five_seconds_at_both_rates() {
        let Some(folder) = bailando_testkit::shared("features/golden/resample_5s") else {
            return;
        };
        let wav = std::fs::read(folder.join("stereo_44100_16bit.wav")).unwrap();
        let song = decode(wav, &[LOW, HIGH]).unwrap();
        // FEATURES section 10.
        for (signal, rate, bound) in [(0, LOW, 1e-4), (1, HIGH, 3e-5)] {
            let file = folder.join(format!("mono_{rate}.npy"));
            let reference = npy(&std::fs::read(file).unwrap());
            let (largest, ratio) = difference(&song.signals[signal], &reference);
            println!("5 s at {rate}: largest {largest:e}, RMS ratio {ratio:e}");
            assert!(largest < 5e-4, "{rate}: {largest}");
            assert!(ratio < bound, "{rate}: {ratio}");
        }
    }
}

mod ranges {
    use super::*;

    #[test]
    fn a_part_is_the_same_samples_and_stops_early() {
        let samples = tone(4 * 8_000, 8_000);
        let whole = decode(wav16(1, 8_000, &samples), &[8_000]).unwrap();
        let range = AudioRange { offset_s: 1.25, duration_s: Some(1.5) };
        let part = decode_part(wav16(1, 8_000, &samples), range, &[8_000, LOW]).unwrap();
        assert_eq!(part.duration_s, 1.5);
        assert_eq!(part.signals[0], whole.signals[0][10_000..22_000]);
        assert_eq!(part.signals[1].len(), 5_760);
        let rest = AudioRange { offset_s: 3.0, duration_s: Some(100.0) };
        let rest = decode_part(wav16(1, 8_000, &samples), rest, &[8_000]).unwrap();
        assert_eq!(rest.signals[0], whole.signals[0][24_000..]);
        assert_eq!(rest.duration_s, 1.0);
    }

    #[test]
    fn a_part_of_a_long_file_is_accepted() {
        let long = SilentFlac {
            rate: 44_100,
            channels: 2,
            frames: 36_000 * 44_100,
            declared: 36_000 * 44_100,
        };
        let range = AudioRange { offset_s: 2.0, duration_s: Some(3.0) };
        let song = decode_part(long.bytes(), range, &[LOW]).unwrap();
        assert_eq!((song.duration_s, song.signals[0].len()), (3.0, 3 * 3_840));
    }

    #[test]
    fn outside_and_impossible_parts_are_refused() {
        let song = Bytes::from(wav16(1, 8_000, &tone(16_000, 8_000)));
        let ask = |offset_s, duration_s| {
            let range = AudioRange { offset_s, duration_s };
            decode_part(song.clone(), range, &[LOW]).unwrap_err()
        };
        for offset in [2.0, 2.5, 1e18] {
            assert!(matches!(
                ask(offset, None),
                AudioError::RangeOutside { length_s, .. } if (length_s - 2.0).abs() < 1e-6
            ));
        }
        for (offset, duration) in [
            (-1.0, None),
            (f64::NAN, None),
            (f64::INFINITY, None),
            (0.0, Some(0.0)),
            (0.0, Some(-2.0)),
            (0.0, Some(f64::NAN)),
        ] {
            assert!(matches!(ask(offset, duration), AudioError::InvalidRange { .. }));
        }
        for (offset, duration, wanted) in [
            (1.9, None, "the audio is 2.000 s long, and `offset_s`, 1.9, leaves 0.100 s of it; at"),
            (1.9, Some(1.0), "the audio is 2.000 s long, and `offset_s`, 1.9, leaves"),
            (0.0, Some(0.2), "`duration_s` asks for 0.2 s; at least 0.5 s are needed"),
            (1.0, Some(0.2), "`duration_s` asks for 0.2 s; at least 0.5 s are needed"),
        ] {
            let error = ask(offset, duration);
            assert!(matches!(error, AudioError::PartTooShort { .. }), "{error}");
            assert!(error.to_string().starts_with(wanted), "{error}");
        }
    }
}
#[path = "audio/bombs.rs"]
mod bombs;
#[path = "audio/cases.rs"]
mod cases;
#[path = "audio/damage.rs"]
mod damage;
#[path = "audio/limits.rs"]
mod limits;
