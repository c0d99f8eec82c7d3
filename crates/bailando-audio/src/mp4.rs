//! Lead-in and padding of an M4A's decoded audio. Symphonia does not apply edit lists, so the few
//! boxes that matter are read here: a bounded walk over the box tree (ISO 14496-12), no allocation,
//! nothing trusted.

/// Most children of one box that are read.
const MAX_CHILDREN: usize = 1024;

/// The audible part of an audio track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Audible {
    /// Seconds of silence before the sound starts.
    pub(crate) silence_s: f64,
    /// Seconds of lead-in to cut off.
    pub(crate) start_s: f64,
    /// Seconds to keep after it; absent: to the end.
    pub(crate) length_s: Option<f64>,
}

/// Returns the audible part of the track `track_id`, from iTunes' tag or else from the edit list.
/// `rate` is the track's sample rate in Hz. `None`: the file does not say.
pub(crate) fn audible(file: &[u8], track_id: u32, rate: u32) -> Option<Audible> {
    let movie = child(file, b"moov")?;
    let edits = edit_list(movie, track_id);
    let silence_s = edits.map_or(0.0, |edits| edits.silence_s);
    itunes_gapless(movie, rate).map(|tag| Audible { silence_s, ..tag }).or(edits)
}

/// Returns whether a file is a movie: it starts with its type, or, as old QuickTime files do, with
/// another box, and has a table of contents.
pub(crate) fn is_movie(file: &[u8]) -> bool {
    match file.get(4..8) {
        Some(b"ftyp") => true,
        Some(b"moov" | b"mdat" | b"wide" | b"free" | b"skip" | b"pnot") => {
            child(file, b"moov").is_some()
        }
        _ => false,
    }
}

/// Iterates over the children of a box as (type, payload) until one does not fit.
fn children(mut bytes: &[u8]) -> impl Iterator<Item = ([u8; 4], &[u8])> {
    std::iter::from_fn(move || {
        let size = u32_be(bytes, 0)?;
        let kind = *bytes.get(4..)?.first_chunk()?;
        let (header, size) = match size {
            0 => (8, bytes.len()),
            1 => (16, usize::try_from(u64_be(bytes, 8)?).ok()?),
            size => (8, size as usize),
        };
        let payload = bytes.get(header..size)?;
        bytes = &bytes[size..];
        Some((kind, payload))
    })
    .take(MAX_CHILDREN)
}

fn child<'bytes>(bytes: &'bytes [u8], wanted: &[u8; 4]) -> Option<&'bytes [u8]> {
    children(bytes).find(|(kind, _)| kind == wanted).map(|(_, payload)| payload)
}

/// ` 00000000 <delay> <padding> <frames> ..` in hexadecimal, written by iTunes and Core Audio.
fn itunes_gapless(movie: &[u8], rate: u32) -> Option<Audible> {
    let meta = child(child(movie, b"udta")?, b"meta")?;
    // `meta` starts with version and flags; `data` with a type and a locale.
    let list = child(meta.get(4..)?, b"ilst")?;
    let text = children(list)
        .filter(|(kind, _)| kind == b"----")
        .find(|(_, item)| child(item, b"name").and_then(|name| name.get(4..)) == Some(b"iTunSMPB"))
        .and_then(|(_, item)| child(item, b"data")?.get(8..))?;
    let mut numbers = std::str::from_utf8(text)
        .ok()?
        .split_ascii_whitespace()
        .skip(1)
        .map(|number| u64::from_str_radix(number, 16).ok());
    let (delay, _padding, frames) = (numbers.next()??, numbers.next()??, numbers.next()??);
    if rate == 0 || frames == 0 {
        return None;
    }
    Some(Audible {
        silence_s: 0.0,
        start_s: delay as f64 / f64::from(rate),
        length_s: Some(frames as f64 / f64::from(rate)),
    })
}

/// Returns the first edit that is heard. With several such edits only the lead-in is applied.
fn edit_list(movie: &[u8], track_id: u32) -> Option<Audible> {
    let movie_scale = timescale(child(movie, b"mvhd")?)?;
    let track = children(movie)
        .filter(|(kind, _)| kind == b"trak")
        .map(|(_, track)| track)
        .find(|track| child(track, b"tkhd").and_then(track_number) == Some(track_id))?;
    let media_scale = timescale(child(child(track, b"mdia")?, b"mdhd")?)?;
    let list = child(child(track, b"edts")?, b"elst")?;
    let long = *list.first()? == 1;
    let entries = list.get(8..)?.chunks_exact(if long { 20 } else { 12 });
    let mut silence = 0_u64;
    let mut shown = entries.take(MAX_CHILDREN.min(u32_be(list, 4)? as usize)).filter_map(|entry| {
        let (duration, start) = if long {
            (u64_be(entry, 0)?, u64_be(entry, 8)?.cast_signed())
        } else {
            let start = u32_be(entry, 4)?.cast_signed();
            (u64::from(u32_be(entry, 0)?), i64::from(start))
        };
        Some((duration, start))
    });
    // A start of -1 is an empty edit: nothing is heard for a while.
    let (duration, start) = loop {
        let (duration, start) = shown.next()?;
        match u64::try_from(start) {
            Ok(start) => break (duration, start),
            Err(_) => silence = silence.saturating_add(duration),
        }
    };
    // A duration of 0 is what fragmented files write for "to the end".
    let whole = duration > 0 && !shown.any(|(_, start)| start >= 0);
    Some(Audible {
        silence_s: silence as f64 / movie_scale,
        start_s: start as f64 / media_scale,
        length_s: whole.then_some(duration as f64 / movie_scale),
    })
}

/// Returns the ticks a second of a `mvhd` or `mdhd` box.
fn timescale(header: &[u8]) -> Option<f64> {
    let scale = u32_be(header, if *header.first()? == 1 { 20 } else { 12 })?;
    (scale > 0).then_some(f64::from(scale))
}

/// Returns the track's id in a `tkhd` box.
fn track_number(header: &[u8]) -> Option<u32> {
    u32_be(header, if *header.first()? == 1 { 20 } else { 12 })
}

fn u32_be(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u64_be(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn atom(kind: &[u8; 4], parts: &[&[u8]]) -> Vec<u8> {
        let payload = parts.concat();
        let size = u32::try_from(payload.len() + 8).unwrap();
        [&size.to_be_bytes(), kind.as_slice(), &payload].concat()
    }

    fn words(values: &[u32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_be_bytes()).collect()
    }

    /// A movie of 1000 ticks a second with one track (id 1, 44.1 kHz) with these edits.
    fn movie(edits: &[[u32; 3]], tags: &[u8]) -> Vec<u8> {
        let entries: Vec<u32> = edits.iter().flatten().copied().collect();
        let count = u32::try_from(edits.len()).unwrap();
        let list = atom(b"elst", &[&words(&[0, count]), &words(&entries)]);
        let header = atom(b"mdhd", &[&words(&[0, 0, 0, 44_100, 0])]);
        let track = atom(
            b"trak",
            &[
                &atom(b"tkhd", &[&words(&[0, 0, 0, 1, 0])]),
                &atom(b"edts", &[&list]),
                &atom(b"mdia", &[&header]),
            ],
        );
        let mvhd = atom(b"mvhd", &[&words(&[0, 0, 0, 1_000, 0])]);
        [atom(b"ftyp", &[b"M4A "]), atom(b"moov", &[&mvhd, &track, tags])].concat()
    }

    #[test]
    fn the_edit_list_gives_start_and_length() {
        let file = movie(&[[30_000, 1_024, 0x1_0000]], &[]);
        let found = audible(&file, 1, 44_100).unwrap();
        assert_eq!(found.start_s, 1_024.0 / 44_100.0);
        assert_eq!(found.length_s, Some(30.0));
        assert_eq!(audible(&file, 2, 44_100), None, "another track");
    }

    #[test]
    fn an_empty_edit_is_silence_and_several_give_the_start_alone() {
        let empty = [500, u32::MAX, 0x1_0000];
        let file = movie(&[empty, [1_000, 2_048, 0x1_0000], [1_000, 99_000, 0x1_0000]], &[]);
        let found = audible(&file, 1, 44_100).unwrap();
        assert_eq!((found.start_s, found.length_s), (2_048.0 / 44_100.0, None));
        assert_eq!(found.silence_s, 0.5);
        let single = movie(&[empty, [1_000, 0, 0x1_0000]], &[]);
        assert_eq!(audible(&single, 1, 44_100).unwrap().length_s, Some(1.0));
    }

    #[test]
    fn the_itunes_tag_comes_first() {
        let text = b" 00000000 00000840 000001CA 00000000003F31F6 00000000";
        let item = atom(
            b"----",
            &[
                &atom(b"mean", &[&words(&[0]), b"com.apple.iTunes"]),
                &atom(b"name", &[&words(&[0]), b"iTunSMPB"]),
                &atom(b"data", &[&words(&[1, 0]), text]),
            ],
        );
        let meta = atom(b"meta", &[&words(&[0]), &atom(b"ilst", &[&item])]);
        let file = movie(&[[30_000, 1_024, 0x1_0000]], &atom(b"udta", &[&meta]));
        let found = audible(&file, 1, 44_100).unwrap();
        assert_eq!(found.start_s, 2_112.0 / 44_100.0);
        assert_eq!(found.length_s, Some(f64::from(0x3f_31f6) / 44_100.0));
    }

    #[test]
    fn damage_is_no_more_than_nothing_known() {
        let file = movie(&[[30_000, 1_024, 0x1_0000]], &[]);
        for end in 0..file.len() {
            audible(&file[..end], 1, 44_100);
        }
        for at in 0..file.len() {
            for value in [0, 1, 0xff] {
                let mut file = file.clone();
                file[at] = value;
                audible(&file, 1, 44_100);
            }
        }
    }
}
