//! What symphonia's reader of movies gets to see: the sound of the file, with tables that cost it
//! no more than they are long. Its times of samples are looked up from the first entry on, sample
//! by sample; so long tables of times are replaced by their mean, other tracks are hidden, and
//! tables that cannot be true are refused before anything is decoded.

use std::ops::Range;

use bytes::Bytes;

use crate::{container::Container, error::AudioError, rope};

/// Most tracks of a file.
const MOST_TRACKS: usize = 64;
/// Entries of a table of times that are looked up one by one.
const SHORT_TABLE: u32 = 64;
/// Entries that stand for no sample; some programs write one.
const EMPTY_ENTRIES: u32 = 16;

type Repairs = Vec<(usize, Vec<u8>)>;

/// A box: its type, where it starts, its content.
struct Atom {
    kind: [u8; 4],
    at: usize,
    body: Range<usize>,
}

/// Returns the slices of `file` for the reader, with only the tracks of sound, or only `chosen`.
///
/// # Errors
/// [`AudioError::Malformed`] for tables that cannot be true.
pub(crate) fn view(file: &Bytes, chosen: Option<u32>) -> Result<Vec<Bytes>, AudioError> {
    let mut repairs = Repairs::new();
    let (mut typed, mut work) = (false, 0);
    let (mut contents, mut media) = (None, None);
    for atom in atoms(file, 0..file.len()) {
        match &atom.kind {
            b"ftyp" => typed = true,
            b"moov" => {
                movie(file, &atom, chosen, &mut repairs)?;
                contents.get_or_insert(atom.body);
            }
            b"mdat" => {
                media.get_or_insert(atom.body);
            }
            b"moof" => fragment(file, &atom, &mut work)?,
            _ => {}
        }
    }
    let mut parts = rope::repaired(file, repairs);
    if !typed {
        // Where the type was cut off, positions count it all the same; old files never had one.
        match contents.zip(media).and_then(|(movie, media)| lost_type(file, movie, media)) {
            Some(length) => parts.insert(0, file_type(length)),
            None => parts.push(file_type(SHORTEST_TYPE)),
        }
    }
    Ok(parts)
}

/// Shortest box of a file's type: without compatible types.
const SHORTEST_TYPE: usize = 16;

/// Returns a box of a file's type, which symphonia's reader insists on.
fn file_type(length: usize) -> Bytes {
    let mut atom = (length as u32).to_be_bytes().to_vec();
    atom.extend(b"ftypqt  ");
    atom.resize(length, 0);
    Bytes::from(atom)
}

/// Returns the length of the type that was cut off the front of a file: its tables place the media
/// so much further back than they are, and beyond their end.
fn lost_type(file: &[u8], movie: Range<usize>, media: Range<usize>) -> Option<usize> {
    const LONGEST: usize = 64;
    let (mut first, mut bytes) = (usize::MAX, 0_usize);
    for track in atoms(file, movie).filter(|atom| &atom.kind == b"trak") {
        let table = |kind| find(file, &track, &[b"mdia", b"minf", b"stbl", kind]);
        let numbers = |table: Option<Atom>, from: usize| {
            let body = table.map_or(0..0, |table| table.body);
            let words = file.get(body.start + from.min(body.len())..body.end).unwrap_or_default();
            let words = words.chunks_exact(4).map(|word| word.first_chunk().copied());
            words.map(|word| u32::from_be_bytes(word.unwrap_or_default()) as usize)
        };
        first = numbers(table(b"stco"), 8).fold(first, usize::min);
        bytes = numbers(table(b"stsz"), 12).fold(bytes, usize::saturating_add);
    }
    let shift = first.checked_sub(media.start)?;
    let beyond = first.saturating_add(bytes) > media.end;
    (beyond && (SHORTEST_TYPE..=LONGEST).contains(&shift)).then_some(shift)
}

/// Hides the tracks that are not used, and looks at the tables of the others.
fn movie(
    file: &[u8],
    movie: &Atom,
    chosen: Option<u32>,
    repairs: &mut Repairs,
) -> Result<(), AudioError> {
    let tracks = || atoms(file, movie.body.clone()).filter(|atom| &atom.kind == b"trak");
    let count = tracks().count();
    if count > MOST_TRACKS {
        return Err(malformed(format!("it has {count} tracks; at most {MOST_TRACKS} are read")));
    }
    let mut hidden = Vec::new();
    for track in tracks() {
        let id = find(file, &track, &[b"tkhd"]).and_then(|header| number(file, &header));
        let handler = find(file, &track, &[b"mdia", b"hdlr"]);
        let is_sound = handler.is_some_and(|handler| {
            file.get(handler.body.start + 8..handler.body.start + 12) == Some(b"soun")
        });
        if is_sound && chosen.is_none_or(|chosen| id == Some(chosen)) {
            tables(file, &track, repairs)?;
        } else {
            repairs.push((track.at + 4, b"free".to_vec()));
            hidden.extend(id);
        }
    }
    // The defaults of fragments have to name the tracks that are left.
    if let Some(extends) = atoms(file, movie.body.clone()).find(|atom| &atom.kind == b"mvex") {
        for defaults in atoms(file, extends.body).filter(|atom| &atom.kind == b"trex") {
            let id = word(file, defaults.body.start + 4);
            if id.is_some_and(|id| hidden.contains(&id)) {
                repairs.push((defaults.at + 4, b"free".to_vec()));
            }
        }
    }
    Ok(())
}

/// Checks the tables of a track, and shortens that of the times.
fn tables(file: &[u8], track: &Atom, repairs: &mut Repairs) -> Result<(), AudioError> {
    let path = [b"mdia", b"minf", b"stbl"];
    let table = |kind| {
        let table = find(file, track, &[path[0], path[1], path[2], kind])?;
        let words: Vec<u32> = (0..3).filter_map(|n| word(file, table.body.start + 4 * n)).collect();
        Some((table, words))
    };
    let samples = match table(b"stsz") {
        Some((sizes, words)) => {
            let (size, count) =
                (words.get(1).copied().unwrap_or(0), words.get(2).copied().unwrap_or(0));
            let bytes = u64::from(size) * u64::from(count);
            let listed = if size == 0 { 4 * u64::from(count) } else { 0 };
            if bytes > 2 * file.len() as u64 + 65_536 || listed > sizes.body.len() as u64 {
                return Err(malformed(format!(
                    "its tables list more audio than the file has bytes: {count} packets"
                )));
            }
            count
        }
        None => return Ok(()),
    };
    let chunks = [b"stco", b"co64"].into_iter().find_map(table);
    let chunks = chunks.and_then(|(_, words)| words.get(1).copied()).unwrap_or(0);
    if let Some((_, words)) = table(b"stsc")
        && words.get(1).is_some_and(|&groups| groups > chunks.max(1))
    {
        let groups = words[1];
        return Err(malformed(format!("it has {groups} groups of chunks for {chunks} chunks")));
    }
    match table(b"stts") {
        Some((times, words)) => {
            let entries = words.get(1).copied().unwrap_or(0);
            shorten(file, times.body.start + 4, entries, samples, repairs)
        }
        None => Ok(()),
    }
}

/// Replaces a long table of times at `at` by one entry of the same length.
fn shorten(
    file: &[u8],
    at: usize,
    entries: u32,
    samples: u32,
    repairs: &mut Repairs,
) -> Result<(), AudioError> {
    if entries <= SHORT_TABLE {
        return Ok(());
    }
    let (mut count, mut time, mut empty) = (0_u64, 0_u64, 0);
    for entry in 0..entries as usize {
        let (Some(run), Some(each)) =
            (word(file, at + 4 + 8 * entry), word(file, at + 8 + 8 * entry))
        else {
            return Err(malformed("its table of times is cut short".to_owned()));
        };
        count += u64::from(run);
        time = time.saturating_add(u64::from(run) * u64::from(each));
        empty += u32::from(run == 0);
    }
    if empty > EMPTY_ENTRIES || u64::from(entries - empty) > u64::from(samples) {
        return Err(malformed(format!(
            "its table of times has {entries} entries, {empty} of them empty, for {samples} packets"
        )));
    }
    let mean = time.checked_div(count).and_then(|mean| u32::try_from(mean).ok());
    let (Ok(count), Some(mean)) = (u32::try_from(count), mean) else {
        return Err(malformed("its table of times counts too many packets".to_owned()));
    };
    repairs.push((at, [1, count, mean].into_iter().flat_map(u32::to_be_bytes).collect()));
    Ok(())
}

/// Adds the work that the runs of a fragment are, and refuses more than a song can be.
fn fragment(file: &[u8], fragment: &Atom, work: &mut u64) -> Result<(), AudioError> {
    /// Steps of looking samples up: a run of 64 k samples with times of their own.
    const MOST_WORK: u64 = 1 << 31;
    for track in atoms(file, fragment.body.clone()).filter(|atom| &atom.kind == b"traf") {
        let (mut runs, mut samples) = (0_u64, 0_u64);
        for run in atoms(file, track.body).filter(|atom| &atom.kind == b"trun") {
            let count = u64::from(word(file, run.body.start + 4).unwrap_or(0));
            let flags = word(file, run.body.start).unwrap_or(0) & 0xff_ffff;
            let fields = u64::from((flags & 0xf00).count_ones());
            if 4 * fields * count > run.body.len() as u64 || count > file.len() as u64 {
                return Err(malformed(format!(
                    "its tables list more audio than the file has bytes: {count} packets"
                )));
            }
            (runs, samples) = (runs + 1, samples.saturating_add(count));
            let looked_up = if flags & 0x100 != 0 { count * count / 2 } else { count };
            *work = work.saturating_add(looked_up);
        }
        *work = work.saturating_add(runs.saturating_mul(samples));
        if *work > MOST_WORK {
            return Err(malformed(format!(
                "one of its fragments has {samples} packets in {runs} runs"
            )));
        }
    }
    Ok(())
}

/// Iterates over the boxes in a part of the file, until one does not fit. The last one may say that
/// it reaches to the end; media data may be cut off there.
fn atoms(file: &[u8], part: Range<usize>) -> impl Iterator<Item = Atom> + '_ {
    let mut at = part.start;
    std::iter::from_fn(move || {
        let kind = *file.get(at.checked_add(4)?..part.end)?.first_chunk()?;
        let (header, size) = match word(file, at)? {
            0 => (8, part.end - at),
            1 => {
                let size = u64::from_be_bytes(*file.get(at + 8..part.end)?.first_chunk()?);
                (16, usize::try_from(size).ok()?)
            }
            size => (8, size as usize),
        };
        let end = at.checked_add(size)?.min(part.end);
        let atom = Atom { kind, at, body: at + header..end };
        if atom.body.start > end {
            return None;
        }
        at = end;
        Some(atom)
    })
}

fn find(file: &[u8], within: &Atom, path: &[&[u8; 4]]) -> Option<Atom> {
    let (first, rest) = path.split_first()?;
    let found = atoms(file, within.body.clone()).find(|atom| atom.kind == **first)?;
    if rest.is_empty() { Some(found) } else { find(file, &found, rest) }
}

/// Returns the id in a track's header.
fn number(file: &[u8], header: &Atom) -> Option<u32> {
    let long = *file.get(header.body.start)? == 1;
    word(file, header.body.start + if long { 20 } else { 12 })
}

fn word(file: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*file.get(at..)?.first_chunk()?))
}

fn malformed(reason: String) -> AudioError {
    AudioError::Malformed { container: Container::M4a, reason }
}
