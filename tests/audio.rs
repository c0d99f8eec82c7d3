//! Audio: every accepted format, alignment between them, golden resampling, limits, bombs, damage.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::large_stack_arrays,
    reason = "tests stop where something is not as it should be, and say what they measured"
)]

#[allow(unreachable_pub, reason = "shared by several test binaries")]
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
    let samples: Vec<i16> = flac.signals[0]
        .iter()
        .map(|&sample| (sample * 32_768.0) as i16)
        .collect();
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
        let Some(folder) = common::shared("features/golden/resample_5s") else {
            return;
        };
        let wav = std::fs::read(folder.join("stereo_44100_16bit.wav")).unwrap();
        let song = decode(wav, &[LOW, HIGH]).unwrap();
        // FEATURES section 10 gives the RMS ratios to one digit: 1e-4 and 3e-5.
        for (signal, rate, digit) in [(0, LOW, 1e-4), (1, HIGH, 3e-5)] {
            let file = folder.join(format!("mono_{rate}.npy"));
            let reference = npy(&std::fs::read(file).unwrap());
            let (largest, ratio) = difference(&song.signals[signal], &reference);
            println!("5 s at {rate}: largest {largest:e}, RMS ratio {ratio:e}");
            assert!(largest < 5e-4, "{rate}: {largest}");
            assert!(
                (ratio * 1e5).round() <= (digit * 1.1_f64 * 1e5).round(),
                "{ratio}"
            );
        }
    }
}

mod ranges {
    use super::*;

    #[test]
    fn a_part_is_the_same_samples_and_stops_early() {
        let samples = tone(4 * 8_000, 8_000);
        let whole = decode(wav16(1, 8_000, &samples), &[8_000]).unwrap();
        let range = AudioRange {
            offset_s: 1.25,
            duration_s: Some(1.5),
        };
        let part = decode_part(wav16(1, 8_000, &samples), range, &[8_000, LOW]).unwrap();
        assert_eq!(part.duration_s, 1.5);
        assert_eq!(part.signals[0], whole.signals[0][10_000..22_000]);
        assert_eq!(part.signals[1].len(), 5_760);
        let rest = AudioRange {
            offset_s: 3.0,
            duration_s: Some(100.0),
        };
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
        let range = AudioRange {
            offset_s: 2.0,
            duration_s: Some(3.0),
        };
        let song = decode_part(long.bytes(), range, &[LOW]).unwrap();
        assert_eq!((song.duration_s, song.signals[0].len()), (3.0, 3 * 3_840));
    }

    #[test]
    fn outside_and_impossible_parts_are_refused() {
        let song = Bytes::from(wav16(1, 8_000, &tone(16_000, 8_000)));
        let ask = |offset_s, duration_s| {
            let range = AudioRange {
                offset_s,
                duration_s,
            };
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
            assert!(matches!(
                ask(offset, duration),
                AudioError::InvalidRange { .. }
            ));
        }
        assert!(matches!(ask(1.9, None), AudioError::TooShort { .. }));
        assert!(matches!(ask(0.0, Some(0.2)), AudioError::TooShort { .. }));
    }
}

mod limits {
    use super::*;

    #[test]
    fn length() {
        let limits = AudioLimits {
            max_seconds: 2.0,
            ..AudioLimits::default()
        };
        let decode = |frames| {
            let bytes = Bytes::from(wav16(1, 8_000, &tone(frames, 8_000)));
            let cancel = CancelToken::new();
            audio::decode(bytes, AudioRange::default(), &[LOW], &limits, &cancel)
        };
        assert_eq!(decode(16_000).unwrap().duration_s, 2.0);
        for frames in [16_001, 40_000] {
            let error = decode(frames).unwrap_err();
            assert!(
                matches!(error, AudioError::TooLong { max_seconds, .. } if max_seconds == 2.0),
                "{error}"
            );
        }
        assert!(decode(4_000).is_ok());
        let error = decode(3_999).unwrap_err();
        assert!(matches!(error, AudioError::TooShort { .. }), "{error}");
    }

    #[test]
    fn sample_rate() {
        for hz in [0, 1, 7_999, 192_001, u32::MAX] {
            let error = refusal(wav16(1, hz, &[0; 20_000]));
            assert!(
                matches!(error, AudioError::SampleRate { hz: found, .. } if found == hz),
                "{error}"
            );
        }
        let silent = |rate| SilentFlac {
            rate,
            channels: 1,
            frames: 100_000,
            declared: 100_000,
        };
        for rate in [0, 4_000, 600_000] {
            let error = refusal(silent(rate).bytes());
            assert!(matches!(error, AudioError::SampleRate { .. }), "{error}");
        }
        assert!(decode(silent(192_000).bytes(), &[LOW]).is_ok());
    }

    #[test]
    fn channels() {
        for count in [0, 9, 26, 27, u16::MAX] {
            let error = refusal(wav16(count, 44_100, &[0; 44_100]));
            assert!(
                matches!(error, AudioError::Channels { count: found, .. } if found == usize::from(count)),
                "{error}"
            );
        }
        let eight = decode(wav16(8, 8_000, &[800; 64_000]), &[8_000]).unwrap();
        assert_eq!(eight.channels, 8);
        assert_eq!(eight.signals[0], vec![800.0 / 32_768.0; 8_000]);
    }

    #[test]
    fn wall_time_and_cancellation() {
        let song = Bytes::from(fixture("demo.mp3"));
        let limits = AudioLimits {
            max_decode_time: Duration::ZERO,
            ..AudioLimits::default()
        };
        let range = AudioRange::default();
        let late = audio::decode(song.clone(), range, &[LOW], &limits, &CancelToken::new());
        assert!(matches!(late, Err(AudioError::DecodeTimeout { .. })));
        let cancel = CancelToken::new();
        let limits = AudioLimits::default();
        let running = {
            let (song, cancel) = (song.clone(), cancel.clone());
            std::thread::spawn(move || {
                // Much more work than the test waits for.
                (0..1_000).find_map(|_| {
                    audio::decode(song.clone(), range, &[LOW, HIGH], &limits, &cancel).err()
                })
            })
        };
        std::thread::sleep(Duration::from_millis(30));
        cancel.cancel();
        let asked = Instant::now();
        let error = running.join().unwrap();
        assert!(matches!(error, Some(AudioError::Cancelled)));
        assert!(asked.elapsed() < Duration::from_millis(500));
    }

    #[test]
    fn output_rate() {
        let error = decode(fixture("demo.ogg"), &[0]).unwrap_err();
        assert!(matches!(error, AudioError::OutputRate { hz: 0 }));
    }
}

mod bombs {
    use super::*;

    fn peak_kib() -> Option<u64> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
        line.split_whitespace().nth(1)?.parse().ok()
    }

    #[test]
    fn ten_hours_of_silence_are_refused_at_once() {
        let hours = 36_000 * 48_000;
        for (channels, declared) in [(1, hours), (8, hours), (8, 0), (8, 48_000)] {
            let bytes = SilentFlac {
                rate: 48_000,
                channels,
                frames: hours,
                declared,
            }
            .bytes();
            let (size, before, start) = (bytes.len(), peak_kib(), Instant::now());
            let error = refusal(bytes);
            let elapsed = start.elapsed();
            println!(
                "{size} bytes, {channels} channels, declares {declared}: {elapsed:?}, {error}"
            );
            assert!(matches!(error, AudioError::TooLong { .. }), "{error}");
            assert!(elapsed < Duration::from_millis(500), "{elapsed:?}");
            // Other tests of this process allocate as well, far below the 64 MiB allowed.
            if let (Some(before), Some(after)) = (before, peak_kib()) {
                assert!(
                    after.saturating_sub(before) < 64 * 1024,
                    "{before} to {after} KiB"
                );
            }
        }
    }

    #[test]
    fn tables_that_list_the_same_bytes_again_and_again_end() {
        // The size of every sample is one number when the table's own number is not 0: all samples
        // of the M4A become 2 kB long, more than the file holds in all.
        let mut file = fixture("demo.m4a");
        let table = file.windows(4).position(|part| part == b"stsz").unwrap();
        file[table + 8..table + 12].copy_from_slice(&2_000_u32.to_be_bytes());
        file[table + 12..table + 16].copy_from_slice(&4_000_000_u32.to_be_bytes());
        let start = Instant::now();
        let error = refusal(file);
        println!("{error}");
        assert!(start.elapsed() < Duration::from_millis(500));
    }

    #[test]
    fn declared_sizes_reserve_nothing() {
        let start = Instant::now();
        let error = refusal(wav_declaring(1, 44_100, 16, &[0; 980], 2_000_000_000));
        assert!(matches!(error, AudioError::TooShort { .. }), "{error}");
        let few = SilentFlac {
            rate: 44_100,
            channels: 8,
            frames: 65_535,
            declared: 0xf_ffff_ffff,
        };
        assert!(matches!(refusal(few.bytes()), AudioError::TooLong { .. }));
        assert!(start.elapsed() < Duration::from_millis(500));
    }
}

mod damage {
    use super::*;

    #[test]
    fn things_that_are_no_audio() {
        assert!(matches!(refusal(""), AudioError::Empty));
        let container = |bytes: Vec<u8>| {
            let error = refusal(bytes);
            assert!(
                matches!(error, AudioError::UnsupportedContainer { .. }),
                "{error}"
            );
        };
        container(vec![0]);
        container(b"la la la".to_vec());
        container([b"PK\x03\x04".as_slice(), &[7; 500]].concat());
        container([b"\x89PNG\r\n\x1a\n".as_slice(), &[7; 500]].concat());
        assert!(matches!(
            refusal(wav16(2, 44_100, &[])),
            AudioError::TooShort { seconds, .. } if seconds == 0.0
        ));
    }

    #[test]
    fn headers_without_audio() {
        for name in ["demo.flac", "demo.ogg", "demo.m4a", "demo.mp3"] {
            let file = fixture(name);
            for length in [5, 12, 21, 30, 60, 100] {
                let error = refusal(file[..length].to_vec());
                println!("{length} bytes of {name}: {error}");
            }
        }
        let flac = fixture("demo.flac");
        assert!(matches!(
            refusal(flac[..21].to_vec()),
            AudioError::Malformed { .. }
        ));
    }

    #[test]
    fn a_file_cut_in_half_is_used_with_a_warning() {
        let wav = wav16(1, 32_000, &tone(320_000, 32_000));
        for (name, file) in [
            ("demo.flac", fixture("demo.flac")),
            ("demo.mp3", fixture("demo.mp3")),
            ("demo.ogg", fixture("demo.ogg")),
            ("demo.m4a", fixture("demo.m4a")),
            ("wav", wav),
        ] {
            let half = file[..file.len() / 2].to_vec();
            match decode(half, &[LOW]) {
                Ok(song) => {
                    println!("{name}: {} s, {:?}", song.duration_s, song.warnings);
                    assert!((3.0..27.0).contains(&song.duration_s), "{name}");
                    assert!(!song.warnings.is_empty(), "{name}");
                }
                // The index of an M4A may be at its end, and then nothing can be found.
                Err(error) => assert_eq!(name, "demo.m4a", "{error}"),
            }
        }
    }

    #[test]
    fn damaged_packets_become_silence_and_keep_the_time() {
        let whole = decode(fixture("demo.flac"), &[32_000]).unwrap();
        let mut file = fixture("demo.flac");
        let start = file.len() / 2;
        for byte in &mut file[start..start + 40] {
            *byte ^= 0x55;
        }
        let song = decode(file, &[32_000]).unwrap();
        println!("{} s, {:?}", song.duration_s, song.warnings);
        assert!(
            song.warnings
                .iter()
                .any(|warning| warning.contains("silence"))
        );
        assert_eq!(song.duration_s, 30.0);
        let tail = 25 * 32_000;
        assert_eq!(song.signals[0][tail..], whole.signals[0][tail..]);
    }

    #[test]
    fn a_hole_in_an_mp3_is_stepped_over_and_said() {
        let mut file = fixture("demo.mp3");
        let start = file.len() / 2;
        file[start..start + 6_000].fill(0);
        let song = decode(file, &[LOW]).unwrap();
        println!("{} s, {:?}", song.duration_s, song.warnings);
        assert!(!song.warnings.is_empty());
        assert!((29.0..=30.0).contains(&song.duration_s));
    }

    #[test]
    fn an_mp3_without_its_info_frame_is_read_to_its_end() {
        let file = fixture("demo.mp3");
        // The frame that holds the LAME tag is the first one; the next sync starts the music.
        let info = file.windows(4).position(|part| part == b"Info").unwrap();
        let next = file[info..]
            .windows(2)
            .position(|part| part == [0xff, 0xfb]);
        let song = decode(file[info + next.unwrap()..].to_vec(), &[LOW]).unwrap();
        assert!(
            song.duration_s > 30.0 && song.duration_s < 30.1,
            "{}",
            song.duration_s
        );
        assert!(
            song.warnings
                .iter()
                .any(|warning| warning.contains("encoder delay"))
        );
    }

    fn mutants() -> impl Strategy<Value = (usize, Vec<(prop::sample::Index, u8)>, f64)> {
        let edits = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..40);
        (0..5_usize, edits, 0.02..1.0)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn mutants_neither_panic_nor_hang((which, edits, share) in mutants()) {
            let mut file = match which {
                0 => wav16(2, 44_100, &tone(60_000, 44_100)),
                1 => fixture("demo.flac"),
                2 => fixture("demo.mp3"),
                3 => fixture("demo.ogg"),
                _ => fixture("demo.m4a"),
            };
            // Headers decide more than samples do: every second edit goes to the first 2 kB.
            for (count, (at, value)) in edits.iter().enumerate() {
                let reach = if count % 2 == 0 { 2_048 } else { file.len() };
                let at = at.index(reach.min(file.len()));
                file[at] = *value;
            }
            // The index of the M4A is kept whole: cut short it would always be refused.
            if which < 4 {
                file.truncate(((file.len() as f64) * share) as usize);
            }
            let range = AudioRange { offset_s: 0.0, duration_s: Some(4.0) };
            let start = Instant::now();
            let result = decode_part(file, range, &[LOW]);
            prop_assert!(!matches!(result, Err(AudioError::DecoderPanic { .. })), "{result:?}");
            prop_assert!(start.elapsed() < Duration::from_secs(5));
            if let Ok(song) = result {
                prop_assert!(song.signals[0].iter().all(|sample| sample.is_finite()));
                prop_assert!(song.duration_s <= 4.0);
            }
        }
    }
}
