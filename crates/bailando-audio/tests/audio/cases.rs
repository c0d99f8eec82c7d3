//! Files as phones, browsers, recorders and taggers write them. The files of `cases` hold one tone
//! that rises from 300 Hz, so that every result can be compared with what was put in.

use super::*;
use bailando_testkit::wav::wav_declaring;

const TONE_S: f64 = 1.5;

fn case(name: &str) -> Vec<u8> {
    fixture(&format!("cases/{name}"))
}

/// The tone at `t` seconds, silent outside.
fn rising(t: f64) -> f64 {
    let phase = 2.0 * std::f64::consts::PI * (300.0 + 200.0 * t) * t;
    if (0.0..TONE_S).contains(&t) { 0.5 * phase.sin() } else { 0.0 }
}

/// The tone in 16 bits.
fn samples(rate: u32) -> Vec<i16> {
    let count = (TONE_S * f64::from(rate)) as usize;
    (0..count).map(|i| (32_767.0 * rising(i as f64 / f64::from(rate))) as i16).collect()
}

fn bytes_of(samples: &[i16]) -> Vec<u8> {
    samples.iter().flat_map(|sample| sample.to_le_bytes()).collect()
}

/// Checks that `signal` at [`LOW`] is the tone, `late_s` late, by correlation and level. A
/// thousandth of a second more or less would bring the correlation far down.
fn assert_tone(signal: &[f32], late_s: f64) {
    let (mut both, mut got, mut wanted) = (0.0, 0.0, 0.0);
    for i in 0..(1.3 * f64::from(LOW)) as usize {
        let at = i + (late_s * f64::from(LOW)).ceil() as usize;
        let (x, y) = (f64::from(signal[at]), rising(at as f64 / f64::from(LOW) - late_s));
        (both, got, wanted) = (both + x * y, got + x * x, wanted + y * y);
    }
    let (correlation, level) = (both / (got * wanted).sqrt(), (got / wanted).sqrt());
    assert!(correlation > 0.95, "{correlation:.4}");
    assert!((0.85..1.15).contains(&level), "{level:.4}");
}

/// Decodes a whole tone without a warning.
fn clean(bytes: Vec<u8>) -> DecodedAudio {
    let song = decode(bytes, &[LOW]).unwrap();
    assert_eq!(song.warnings, Vec::<String>::new());
    assert!((song.duration_s - TONE_S).abs() < 0.03, "{}", song.duration_s);
    assert_tone(&song.signals[0], 0.0);
    song
}

fn warned(song: &DecodedAudio, words: &str) {
    assert!(song.warnings.iter().any(|warning| warning.contains(words)), "{:?}", song.warnings);
}

mod riff {
    use super::*;

    fn chunk(kind: &[u8; 4], body: &[u8]) -> Vec<u8> {
        let size = u32::try_from(body.len()).unwrap();
        let padding = &[0][..body.len() % 2];
        [kind.as_slice(), &size.to_le_bytes(), body, padding].concat()
    }

    /// A WAV file of the tone with `extra` between description and samples.
    fn with_chunks(form: &[u8; 4], extra: &[u8], samples_size: u32) -> Vec<u8> {
        let plain = wav16(1, 22_050, &samples(22_050));
        let mut file = [form.as_slice(), &plain[4..36], extra, b"data"].concat();
        file.extend(samples_size.to_le_bytes());
        file.extend(&plain[44..]);
        let outer = u32::try_from(file.len() - 8).unwrap();
        file[4..8].copy_from_slice(&outer.to_le_bytes());
        file
    }

    #[test]
    fn sizes_of_zero_are_read_to_the_end_with_a_warning() {
        for outer in [0, 36, u32::MAX] {
            let mut file = wav_declaring(1, 22_050, 16, &bytes_of(&samples(22_050)), 0);
            file[4..8].copy_from_slice(&outer.to_le_bytes());
            let song = decode(file, &[LOW]).unwrap();
            assert_eq!(song.duration_s, TONE_S);
            assert_tone(&song.signals[0], 0.0);
            warned(&song, "states 0 bytes of audio");
        }
    }

    #[test]
    fn an_outer_size_that_is_short_loses_nothing() {
        let mut file = wav16(1, 22_050, &samples(22_050));
        let size = u32::try_from(file.len()).unwrap() - 16;
        file[4..8].copy_from_slice(&size.to_le_bytes());
        let song = decode(file, &[LOW]).unwrap();
        assert_eq!(song.duration_s, TONE_S);
        warned(&song, "all of it is used");
    }

    #[test]
    fn lists_of_odd_length_are_stepped_over_padded_or_not() {
        let data = u32::try_from(2 * samples(22_050).len()).unwrap();
        let list = chunk(b"LIST", b"INFOISFT\x05\0\0\0abcd\0");
        for end in [list.len(), list.len() - 1] {
            let song = clean(with_chunks(b"RIFF", &list[..end], data));
            assert_eq!(song.duration_s, TONE_S);
        }
    }

    #[test]
    fn files_of_64_bits_are_read() {
        let size = 2 * samples(22_050).len() as u64;
        let mut sizes = vec![0; 28];
        sizes[8..16].copy_from_slice(&size.to_le_bytes());
        let song = clean(with_chunks(b"RF64", &chunk(b"ds64", &sizes), u32::MAX));
        assert_eq!(song.duration_s, TONE_S);
    }

    #[test]
    fn a_chunk_behind_the_samples_is_no_sound() {
        let data = u32::try_from(2 * samples(22_050).len()).unwrap();
        let mut file = with_chunks(b"RIFF", &[], data);
        file.extend(chunk(b"id3 ", &[7; 5_000]));
        assert_eq!(decode(file, &[LOW]).unwrap().duration_s, TONE_S);
    }

    #[test]
    fn adpcm_is_read() {
        clean(case("adpcm_ms.wav"));
    }

    #[test]
    fn mp3_in_a_wav_is_danced_and_said() {
        let mp3 = case("mono.mp3");
        let mut file = b"RIFF\0\0\0\0WAVE".to_vec();
        file.extend(chunk(b"fmt ", b"\x55\0\x01\0\x44\xac\0\0\x70\x17\0\0\x01\0\0\0\0\0"));
        file.extend(chunk(b"data", &mp3));
        let song = decode(file, &[LOW]).unwrap();
        warned(&song, "holds MP3");
        assert!(song.signals == decode(mp3, &[LOW]).unwrap().signals);
    }

    /// An AIFF file of the tone; AIFF-C where a compression is given.
    fn aiff(compression: Option<&[u8; 4]>, size: Option<u32>) -> Vec<u8> {
        let samples = samples(22_050);
        let chunk = |kind: &[u8; 4], size: u32, body: &[u8]| {
            [kind.as_slice(), &size.to_be_bytes(), body].concat()
        };
        // 22,050 Hz as an 80-bit float.
        let mut description = vec![0, 1, 0, 0, 0, 0, 0, 16, 0x40, 0x0d, 0xac, 0x44];
        description.extend([0; 6]);
        let mut data = vec![0; 8];
        let little = compression == Some(b"sowt");
        for sample in &samples {
            data.extend(if little { sample.to_le_bytes() } else { sample.to_be_bytes() });
        }
        description[2..6].copy_from_slice(&u32::try_from(samples.len()).unwrap().to_be_bytes());
        description.extend(compression.map_or(vec![], |name| [name.as_slice(), &[0, 0]].concat()));
        let form = if compression.is_some() { b"AIFC" } else { b"AIFF" };
        let length = u32::try_from(data.len()).unwrap();
        let common = u32::try_from(description.len()).unwrap();
        let body = [
            form.as_slice(),
            &chunk(b"COMM", common, &description),
            &chunk(b"SSND", size.unwrap_or(length), &data),
        ];
        chunk(b"FORM", 0, &body.concat())
    }

    #[test]
    fn aiff_of_both_byte_orders_is_read() {
        for compression in [None, Some(b"NONE"), Some(b"sowt")] {
            let song = decode(aiff(compression, None), &[LOW]).unwrap();
            assert_eq!((song.duration_s, song.sample_rate), (TONE_S, 22_050), "{compression:?}");
            assert_tone(&song.signals[0], 0.0);
        }
        let song = decode(aiff(None, Some(0)), &[LOW]).unwrap();
        assert_eq!(song.duration_s, TONE_S);
        warned(&song, "states 0 bytes");
    }
}

mod ogg {
    use super::*;
    use bailando_testkit::ogg::{page, pages, set_granule};

    fn granule(page: &[u8]) -> i64 {
        i64::from_le_bytes(page[6..14].try_into().unwrap())
    }

    #[test]
    fn pages_without_a_time_stamp_lose_nothing() {
        let mut all = pages(&fixture("demo.ogg"));
        let last = all.len() - 1;
        for page in all[3..last].iter_mut().step_by(2) {
            set_granule(page, -1);
        }
        let song = decode(all.concat(), &[LOW]).unwrap();
        let whole = decode(fixture("demo.ogg"), &[LOW]).unwrap();
        assert_eq!((song.duration_s, song.warnings), (30.0, vec![]));
        assert!(song.signals == whole.signals);
    }

    #[test]
    fn a_stream_that_does_not_begin_at_0_gets_no_warning() {
        let mut all = pages(&fixture("demo.ogg"));
        for page in &mut all {
            let stamp = granule(page);
            if stamp > 0 {
                set_granule(page, stamp + 100 * 32_000);
            }
        }
        let song = decode(all.concat(), &[LOW]).unwrap();
        assert_eq!((song.duration_s, song.warnings), (30.0, vec![]));
    }

    #[test]
    fn a_skeleton_is_skipped() {
        let all = pages(&fixture("demo.ogg"));
        let head = [b"fishead\0".as_slice(), &[0; 56]].concat();
        let (start, end) = (page(2, 0, 777, 0, &head), page(4, 0, 777, 1, &[]));
        let file = [start, all[..3].concat(), end, all[3..].concat()].concat();
        let song = decode(file, &[LOW]).unwrap();
        assert_eq!((song.duration_s, song.warnings), (30.0, vec![]));
    }

    #[test]
    fn a_picture_beside_the_sound_is_skipped() {
        let song = clean(case("theora.ogg"));
        assert_eq!(song.duration_s, TONE_S);
    }

    #[test]
    fn a_lost_page_becomes_silence_and_keeps_the_time() {
        let mut all = pages(&fixture("demo.ogg"));
        let middle = all.len() / 2;
        all.remove(middle);
        let song = decode(all.concat(), &[LOW]).unwrap();
        let whole = decode(fixture("demo.ogg"), &[LOW]).unwrap();
        warned(&song, "silence");
        assert!((song.duration_s - 30.0).abs() < 0.1, "{}", song.duration_s);
        let tail = 28 * LOW as usize..29 * LOW as usize;
        let (_, ratio) = difference(&song.signals[0][tail.clone()], &whole.signals[0][tail]);
        assert!(ratio < 0.01, "{ratio}");
    }

    #[test]
    fn pages_of_one_byte_and_broken_pages_end_soon() {
        let all = pages(&fixture("demo.ogg"));
        let serial = u32::from_le_bytes(all[0][14..18].try_into().unwrap());
        let head = all[..3].concat();
        let tiny: Vec<u8> =
            (3..100_000).flat_map(|number| page(0, -1, serial, number, &[])).collect();
        let mut broken = page(0, 0, serial, 3, &[1; 60_000]);
        broken[100] ^= 1;
        let start = Instant::now();
        let error = refusal([head.clone(), tiny].concat());
        assert!(error.to_string().contains("could not be decoded"), "{error}");
        // The page with the last header holds a second of music, too.
        let song = decode([head, broken.repeat(100)].concat(), &[LOW]).unwrap();
        warned(&song, "damaged or cut short after 1.0 s");
        assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    }
}

mod mp3 {
    use super::*;

    /// Decoder and encoder start so late in files of LAME without a tag.
    const LATE_S: f64 = (576.0 + 529.0) / 44_100.0;

    #[test]
    fn frames_are_mixed_by_their_own_channels() {
        let (mono, stereo) = (case("mono.mp3"), case("stereo.mp3"));
        for (first, second, channels) in [(&mono, &stereo, 1), (&stereo, &mono, 2)] {
            let song = decode([first.as_slice(), second].concat(), &[LOW]).unwrap();
            let half = song.duration_s / 2.0;
            assert_eq!(song.channels, channels);
            assert!((song.duration_s - 2.0 * 59.0 * 1_152.0 / 44_100.0).abs() < 1e-6);
            assert_tone(&song.signals[0], LATE_S);
            assert_tone(&song.signals[0], half + LATE_S);
            assert_eq!(song.warnings.len(), 1, "{:?}", song.warnings);
            warned(&song, "encoder delay");
        }
    }

    #[test]
    fn another_sample_rate_is_resampled_and_said() {
        let first = case("mono.mp3");
        let song = decode([first, case("mono_32k.mp3")].concat(), &[LOW]).unwrap();
        assert_eq!(song.sample_rate, 44_100);
        let first_s = 59.0 * 1_152.0 / 44_100.0;
        assert_tone(&song.signals[0], LATE_S);
        assert_tone(&song.signals[0], first_s + (576.0 + 529.0) / 32_000.0);
        warned(&song, "changes from 44100 to [32000] Hz");
    }

    /// A tag of `size` (four bytes) whose picture is full of sync words that no frames follow.
    fn tagged(size: [u8; 4], music: &[u8]) -> Vec<u8> {
        let art = [[0xff, 0xfb, 0x50, 0xc0].as_slice(), &[0; 252]].concat().repeat(2_000);
        let size = [b"ID3\x03\0\0".as_slice(), &size].concat();
        [size.as_slice(), b"APIC\0\x08\0\0\0\0\0image/jpeg\0\x03\0", &art, music].concat()
    }

    #[test]
    fn tags_that_lie_and_junk_in_front_are_stepped_over() {
        let music = case("mono.mp3");
        let plain = decode(music.clone(), &[LOW]).unwrap();
        let length = u32::try_from(tagged([0; 4], &[]).len() - 10).unwrap();
        let padded = [b"ID3\x03\0\0\0\0\0\x64".as_slice(), &[0; 200_100], &music].concat();
        for (name, file, words) in [
            ("plain size", tagged(length.to_be_bytes(), &music), "ID3 tag states a wrong size"),
            ("too small", tagged([0, 0, 7, 104], &music), "ID3 tag states a wrong size"),
            ("too large", tagged([0x7f; 4], &music), "ID3 tag states a wrong size"),
            ("padding", padded, "200000 bytes after its end"),
            ("zeros", [vec![0; 8_192], music.clone()].concat(), "8192 bytes in front"),
            ("part of a frame", [&music[50..], &music].concat(), "in front"),
        ] {
            let song = decode(file, &[LOW]).unwrap();
            println!("{name}: {:?}", song.warnings);
            warned(&song, words);
            warned(&song, "encoder delay");
            if name != "part of a frame" {
                assert!(song.signals == plain.signals, "{name}");
            }
        }
    }

    #[test]
    fn an_information_tag_that_cannot_be_true_is_not_believed() {
        let mut file = fixture("demo.mp3");
        let info = file.windows(4).position(|part| part == b"Info").unwrap();
        let whole = decode(file.clone(), &[LOW]).unwrap();
        assert_eq!(whole.warnings, Vec::<String>::new());
        file[info + 8..info + 12].copy_from_slice(&0x7fff_ffff_u32.to_be_bytes());
        let song = decode(file.clone(), &[LOW]).unwrap();
        assert_eq!(song.warnings.len(), 1, "{:?}", song.warnings);
        warned(&song, "encoder delay");
        assert!((30.0..30.1).contains(&song.duration_s));
        // Frames that are possible, but not there: the file was cut.
        let half = decode(fixture("demo.mp3")[..file.len() / 2].to_vec(), &[LOW]).unwrap();
        warned(&half, "it says 30.0 s");
    }

    #[test]
    fn a_tag_of_an_unknown_encoder_gives_a_warning() {
        let mut file = fixture("demo.mp3");
        let info = file.windows(4).position(|part| part == b"Info").unwrap();
        let name = file[info..].windows(3).position(|part| part == b"LAM" || part == b"Lav");
        file[info + name.unwrap()..][..4].copy_from_slice(b"GOGO");
        let song = decode(file, &[LOW]).unwrap();
        warned(&song, "encoder delay");
    }

    #[test]
    fn free_format_is_named() {
        let mut frame = vec![0xff, 0xfb, 0x00, 0xc0];
        frame.resize(700, 0);
        let error = refusal(frame.repeat(40)).to_string();
        assert!(error.contains("free format"), "{error}");
    }
}

mod flac {
    use super::*;

    #[test]
    fn a_smallest_block_of_0_and_a_tag_at_the_end_change_nothing() {
        let whole = decode(fixture("demo.flac"), &[LOW]).unwrap();
        let mut unset = fixture("demo.flac");
        unset[8..10].fill(0);
        let mut neither = unset.clone();
        neither[10..12].fill(0);
        let tagged = [fixture("demo.flac"), b"TAG".to_vec(), vec![b' '; 125]].concat();
        for file in [unset, neither, tagged] {
            let song = decode(file, &[LOW]).unwrap();
            assert_eq!((song.duration_s, song.warnings), (30.0, vec![]));
            assert!(song.signals == whole.signals);
        }
    }
}

mod movies {
    use super::*;

    fn find(file: &[u8], kind: &[u8; 4]) -> usize {
        file.windows(4).position(|part| part == kind).unwrap() + 4
    }

    fn put(file: &mut [u8], at: usize, value: u32) {
        file[at..at + 4].copy_from_slice(&value.to_be_bytes());
    }

    fn word(file: &[u8], at: usize) -> u32 {
        u32::from_be_bytes(file[at..at + 4].try_into().unwrap())
    }

    #[test]
    fn the_first_track_that_can_be_decoded_is_taken() {
        assert_eq!(clean(case("ac3_then_aac.mp4")).duration_s, TONE_S);
        assert_eq!(clean(case("alac.m4a")).duration_s, TONE_S);
    }

    #[test]
    fn a_file_type_may_be_missing_even_when_positions_count_it() {
        let whole = clean(case("aac.mov"));
        let file = case("aac.mov");
        let (length, chunks) = (word(&file, 0), find(&file, b"stco"));
        let cut = file[length as usize..].to_vec();
        assert!(clean(cut).signals == whole.signals, "cut off");
        let mut old = file.clone();
        for chunk in 0..word(&file, chunks + 4) as usize {
            let at = chunks + 8 + 4 * chunk;
            put(&mut old, at, word(&file, at) - length);
        }
        let never = clean(old[length as usize..].to_vec());
        assert!(never.signals == whole.signals, "never there");
    }

    #[test]
    fn sound_that_starts_late_starts_with_silence() {
        let song = decode(case("late.mp4"), &[LOW]).unwrap();
        assert_eq!(song.warnings, Vec::<String>::new());
        assert!((song.duration_s - 2.0).abs() < 2e-3, "{}", song.duration_s);
        let silent = &song.signals[0][..(0.49 * f64::from(LOW)) as usize];
        assert!(silent.iter().all(|sample| sample.abs() < 0.02));
        assert_tone(&song.signals[0], song.duration_s - TONE_S);
    }

    #[test]
    fn fragments_are_read() {
        let song = decode(case("fragments.mp4"), &[LOW]).unwrap();
        assert!((TONE_S..TONE_S + 0.05).contains(&song.duration_s), "{}", song.duration_s);
        assert_tone(&song.signals[0], 1_024.0 / 44_100.0);
    }

    /// What a file of HE-AAC looks like to a reader that knows LC: the container counts in the
    /// doubled rate, the stream in its own.
    #[test]
    fn he_aac_that_the_container_does_not_announce_keeps_its_speed() {
        let mut file = case("aac_22k.m4a");
        let rate = find(&file, b"mp4a") + 24;
        put(&mut file, rate, 44_100 << 16);
        for (kind, at) in [(b"mdhd", 12), (b"mdhd", 16), (b"elst", 12)] {
            let at = find(&file, kind) + at;
            let doubled = 2 * word(&file, at);
            put(&mut file, at, doubled);
        }
        let times = find(&file, b"stts");
        for entry in 0..word(&file, times + 4) as usize {
            let at = times + 12 + 8 * entry;
            let doubled = 2 * word(&file, at);
            put(&mut file, at, doubled);
        }
        let song = clean(file);
        assert_eq!(song.sample_rate, 22_050);
        assert!((song.duration_s - TONE_S).abs() < 1e-3, "{}", song.duration_s);
    }

    #[test]
    fn he_aac_that_is_announced_is_decoded_without_its_upper_band() {
        let mut file = case("aac_22k.m4a");
        let config = file.windows(2).position(|part| part == [0x13, 0x88]).unwrap();
        file[config..config + 5].copy_from_slice(&[0x2b, 0x8a, 0x08, 0, 0]);
        let song = decode(file, &[LOW]).unwrap();
        assert!((song.duration_s - TONE_S).abs() < 1e-3, "{}", song.duration_s);
        assert_tone(&song.signals[0], 0.0);
        warned(&song, "HE-AAC");
    }

    /// The demo with the table `kind` replaced; it is the last thing in the file that counts.
    fn with_table(kind: &[u8; 4], body: &[u8]) -> Vec<u8> {
        let mut file = fixture("demo.m4a");
        let (at, growth) = (find(&file, kind) - 8, body.len() + 8);
        let old = word(&file, at) as usize;
        let size = u32::try_from(growth).unwrap();
        let new = [&size.to_be_bytes(), kind.as_slice(), body].concat();
        for parent in [b"moov", b"trak", b"mdia", b"minf", b"stbl"] {
            let parent = find(&file, parent) - 8;
            let grown = word(&file, parent) + size - u32::try_from(old).unwrap();
            put(&mut file, parent, grown);
        }
        file.splice(at..at + old, new);
        file
    }

    fn words(values: impl IntoIterator<Item = u32>) -> Vec<u8> {
        values.into_iter().flat_map(u32::to_be_bytes).collect()
    }

    #[test]
    fn tables_that_cannot_be_true_are_refused_before_decoding() {
        let empty =
            [0, 60_001].into_iter().chain(std::iter::repeat_n(0, 120_000)).chain([1_293, 1_024]);
        let ones = [0, 60_000].into_iter().chain((0..60_000).flat_map(|_| [1, 1_024]));
        let groups = [0, 60_000].into_iter().chain((0..60_000).flat_map(|n| [n + 1, 1, 1]));
        for (kind, values, words_of_it) in [
            (b"stts", words(empty), "60000 of them empty"),
            (b"stts", words(ones), "for 1293 packets"),
            (b"stsc", words(groups), "groups of chunks"),
            (b"stsz", words([0, 1_000_000, 5_000]), "more audio than the file has"),
        ] {
            let file = with_table(kind, &values);
            let start = Instant::now();
            let error = refusal(file).to_string();
            assert!(error.contains(words_of_it), "{error}");
            assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
        }
    }

    #[test]
    fn a_long_table_of_times_is_read_in_linear_time() {
        let times = [0, 1_293].into_iter().chain((0..1_293).flat_map(|_| [1, 1_024]));
        let song = decode(with_table(b"stts", &words(times)), &[LOW]).unwrap();
        let whole = decode(fixture("demo.m4a"), &[LOW]).unwrap();
        let certain = 29 * LOW as usize;
        assert!(song.signals[0][..certain] == whole.signals[0][..certain]);
        assert_eq!(song.warnings, Vec::<String>::new());
    }
}

mod opus {
    use super::*;

    #[test]
    fn what_browsers_record_is_decoded_to_the_sample() {
        // CELT, SILK with frames of 60 ms, both at once, and a stream without sizes.
        let files =
            [("music.opus", 2), ("speech_60ms.opus", 1), ("hybrid.opus", 1), ("opus.webm", 1)];
        for (name, channels) in files {
            let song = clean(case(name));
            assert_eq!((song.sample_rate, song.channels), (48_000, channels), "{name}");
            assert_eq!(song.duration_s, TONE_S, "{name}");
        }
    }

    #[test]
    fn vorbis_in_webm_is_decoded() {
        clean(case("vorbis.webm"));
    }

    #[test]
    fn flac_mp3_and_plain_samples_in_other_containers_are_decoded() {
        for (name, rate, channels) in
            [("flac.ogg", 16_000, 2), ("flac.mka", 16_000, 2), ("pcm.mka", 8_000, 1)]
        {
            let song = clean(case(name));
            assert_eq!((song.sample_rate, song.channels), (rate, channels), "{name}");
            assert!((song.duration_s - TONE_S).abs() < 1e-3, "{name}: {}", song.duration_s);
        }
        let song = decode(case("mp3.mka"), &[LOW]).unwrap();
        warned(&song, "does not state its encoder delay");
        // The encoder's delay before it, and whole frames to its end.
        let more = song.duration_s - TONE_S;
        assert!((0.0..(1_105.0 + 2.0 * 1_152.0) / 44_100.0).contains(&more), "{more}");
    }

    #[test]
    fn a_recording_that_broke_off_is_used_with_a_warning() {
        for name in ["music.opus", "opus.webm"] {
            let file = case(name);
            let song = decode(file[..file.len() * 2 / 3].to_vec(), &[LOW]).unwrap();
            println!("{name}: {} s, {:?}", song.duration_s, song.warnings);
            assert!((0.7..1.3).contains(&song.duration_s), "{name}");
            warned(&song, "cut short");
        }
    }

    #[test]
    fn more_channels_than_two_are_named() {
        let mut file = case("music.opus");
        let head = file.windows(8).position(|part| part == b"OpusHead").unwrap();
        file[head + 9] = 6;
        let mut pages = bailando_testkit::ogg::pages(&file);
        bailando_testkit::ogg::seal(&mut pages[0]);
        let error = refusal(pages.concat()).to_string();
        assert!(error.contains("Opus with more than 2 channels"), "{error}");
    }
}

mod heard {
    use super::*;

    #[test]
    fn channels_that_cancel_give_one_of_them() {
        let opposite: Vec<i16> = samples(22_050).iter().flat_map(|&s| [s, -s]).collect();
        let song = decode(wav16(2, 22_050, &opposite), &[LOW]).unwrap();
        let single = decode(wav16(1, 22_050, &samples(22_050)), &[LOW]).unwrap();
        warned(&song, "cancel each other");
        let (_, plus) = difference(&song.signals[0], &single.signals[0]);
        let minus: Vec<f32> = single.signals[0].iter().map(|sample| -sample).collect();
        let (_, minus) = difference(&song.signals[0], &minus);
        assert!(plus.min(minus) < 1e-4, "{plus} {minus}");
    }

    #[test]
    fn wide_stereo_is_mixed_as_ever() {
        let wide: Vec<i16> = samples(22_050).iter().flat_map(|&s| [s, -(s / 2)]).collect();
        let song = decode(wav16(2, 22_050, &wide), &[LOW]).unwrap();
        assert_eq!(song.warnings, Vec::<String>::new());
    }

    #[test]
    fn silence_is_said() {
        let song = decode(wav16(1, 22_050, &[0; 22_050]), &[LOW]).unwrap();
        warned(&song, "silent");
    }
}
