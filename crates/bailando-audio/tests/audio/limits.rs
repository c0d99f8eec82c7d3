//! Every limit of the decoder, and what the message then says.

use super::*;

#[test]
fn length() {
    let limits = AudioLimits { max_seconds: 2.0, ..AudioLimits::default() };
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
    let silent = |rate| SilentFlac { rate, channels: 1, frames: 100_000, declared: 100_000 };
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
            matches!(
                error,
                AudioError::Channels { count: found, .. } if found == usize::from(count)
            ),
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
    let limits = AudioLimits { max_decode_time: Duration::ZERO, ..AudioLimits::default() };
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
