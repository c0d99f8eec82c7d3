//! Files without audio, with damaged audio and with a part of it.

use super::*;

#[test]
fn things_that_are_no_audio() {
    assert!(matches!(refusal(""), AudioError::Empty));
    let container = |bytes: Vec<u8>| {
        let error = refusal(bytes);
        assert!(matches!(error, AudioError::UnsupportedContainer { .. }), "{error}");
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
    assert!(matches!(refusal(flac[..21].to_vec()), AudioError::Malformed { .. }));
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
    assert!(song.warnings.iter().any(|warning| warning.contains("silence")));
    assert_eq!(song.duration_s, 30.0);
    let tail = 25 * 32_000;
    assert_eq!(song.signals[0][tail..], whole.signals[0][tail..]);
}

/// Where the first frame of a FLAC file starts.
fn first_frame(file: &[u8]) -> usize {
    let mut at = 4;
    loop {
        let size = u32::from_be_bytes([0, file[at + 1], file[at + 2], file[at + 3]]);
        let last = file[at] & 0x80 != 0;
        at += 4 + size as usize;
        if last {
            return at;
        }
    }
}

#[test]
fn flac_frames_lost_in_front_become_silence_and_keep_the_time() {
    let whole = decode(fixture("demo.flac"), &[32_000]).unwrap();
    let start = first_frame(&fixture("demo.flac"));
    let block = usize::from(u16::from_be_bytes([fixture("demo.flac")[8], fixture("demo.flac")[9]]));
    // Inside the first frame; its header; the headers of several frames.
    for damaged in [start + 100..start + 140, start..start + 40, start..start + 20_000] {
        let mut file = fixture("demo.flac");
        for byte in &mut file[damaged.clone()] {
            *byte ^= 0x55;
        }
        let song = decode(file, &[32_000]).unwrap();
        println!("{damaged:?}: {} s, {:?}", song.duration_s, song.warnings);
        assert!(song.warnings[0].contains("silence"));
        assert_eq!(song.duration_s, 30.0);
        assert!(song.signals[0][..block].iter().all(|&sample| sample == 0.0));
        let tail = 5 * 32_000;
        assert!(song.signals[0][tail..] == whole.signals[0][tail..]);
    }
}

#[test]
fn a_flac_that_was_cut_in_front_starts_with_its_first_frame_and_says_so() {
    let blocks = |count: u64| SilentFlac {
        rate: 44_100,
        channels: 1,
        frames: count * 65_535,
        declared: 4 * 65_535,
    };
    let file = blocks(4).bytes();
    let frame = (file.len() - blocks(0).bytes().len()) / 4;
    let start = first_frame(&file);
    let song = decode([&file[..start], &file[start + frame..]].concat(), &[LOW]).unwrap();
    println!("{} s, {:?}", song.duration_s, song.warnings);
    assert_eq!(song.duration_s, 3.0 * 65_535.0 / 44_100.0);
    assert_eq!(song.warnings.len(), 2);
    assert!(song.warnings[0].contains("1.5 s before it are missing"));
    assert!(song.warnings[1].contains("silent"));
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
    let next = file[info..].windows(2).position(|part| part == [0xff, 0xfb]);
    let song = decode(file[info + next.unwrap()..].to_vec(), &[LOW]).unwrap();
    assert!(song.duration_s > 30.0 && song.duration_s < 30.1, "{}", song.duration_s);
    assert!(song.warnings.iter().any(|warning| warning.contains("encoder delay")));
}

fn mutants() -> impl Strategy<Value = (usize, Vec<(prop::sample::Index, u8)>, f64)> {
    let edits = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..40);
    (0..8_usize, edits, 0.02..1.0)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 150,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn mutants_neither_panic_nor_hang((which, edits, share) in mutants()) {
        let mut file = match which {
            0 => wav16(2, 44_100, &tone(60_000, 44_100)),
            1 => fixture("demo.flac"),
            2 => fixture("demo.mp3"),
            3 => fixture("demo.ogg"),
            5 => fixture("cases/music.opus"),
            6 => fixture("cases/opus.webm"),
            7 => fixture("cases/fragments.mp4"),
            _ => fixture("demo.m4a"),
        };
        // Headers decide more than samples do: every second edit goes to the first 2 kB.
        for (count, (at, value)) in edits.iter().enumerate() {
            let reach = if count % 2 == 0 { 2_048 } else { file.len() };
            let at = at.index(reach.min(file.len()));
            file[at] = *value;
        }
        // The index of the M4A is kept whole: cut short it would always be refused.
        if which != 4 {
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

#[test]
fn a_wav_from_a_pipe_states_no_length_and_is_whole() {
    let samples = tone(16_000, 8_000);
    let data: Vec<u8> = samples.iter().flat_map(|s| s.to_le_bytes()).collect();
    let song = decode(wav_declaring(1, 8_000, 16, &data, u32::MAX), &[8_000]).unwrap();
    assert_eq!((song.duration_s, song.signals[0].len()), (2.0, 16_000));
    assert!(song.warnings.is_empty(), "{:?}", song.warnings);
}

#[test]
fn an_ogg_cut_between_two_pages_is_said_to_be_cut() {
    let file = fixture("demo.ogg");
    let pages: Vec<usize> =
        (0..file.len() - 4).filter(|&at| file[at..].starts_with(b"OggS")).collect();
    let cut = decode(file[..pages[pages.len() / 2]].to_vec(), &[LOW]).unwrap();
    println!("{} s, {:?}", cut.duration_s, cut.warnings);
    assert!(cut.warnings.iter().any(|warning| warning.contains("cut short")));
}

#[test]
fn joined_files_lose_no_music() {
    let twice = |name| [fixture(name), fixture(name)].concat();
    // The second file's tag and lead-in stay between the two songs; nothing is cut at the end.
    let mp3 = decode(twice("demo.mp3"), &[LOW]).unwrap();
    println!("{} s, {:?}", mp3.duration_s, mp3.warnings);
    assert!((60.0..60.2).contains(&mp3.duration_s));
    let ogg = decode(twice("demo.ogg"), &[LOW]).unwrap();
    println!("{} s, {:?}", ogg.duration_s, ogg.warnings);
    assert_eq!(ogg.duration_s, 30.0);
    assert!(ogg.warnings.iter().any(|warning| warning.contains("first of several")));
}
