//! Place of a moment within the count, the bar and the phrase.
//!
//! Column 53 marks beats one row at a time, two rows late at 7.5 rows a second (FEATURES section
//! 8), and trackers find the count in one song and half of it in the next. A dancer needs to know
//! how far away the next count is, and its number: these columns hold both.

use std::f64::consts::TAU;

use ndarray::{Array2, ArrayView2, Axis, Slice};

use crate::{
    beat::Beats,
    beats::{
        SongBeats,
        counts::{counts_of, octaves_above},
    },
    layout::{CHROMA_COLUMNS, Rate},
    novelty::novelty,
};

/// Slowest counts per minute of the octave from it to its double: dancers count neither slower nor
/// faster.
const SLOWEST_COUNT_BPM: f64 = 130.0;
/// Counts of a bar, and of a phrase of two bars.
const BAR: usize = 4;
const PHRASE: usize = 8;
/// Octaves by which a place in a phrase becomes its start.
const MOST_OCTAVES: i32 = PHRASE.ilog2() as i32;
/// Fewer beats have no regular distance.
const MIN_BEATS: usize = 4;
/// What a change of harmony weighs against an active first beat (BEATS, place in the phrase).
const HARMONY: f64 = 0.5;

/// The counts of a song, and the bars and phrases that they make up.
#[derive(Clone, Debug, PartialEq)]
pub struct BeatPhase {
    /// Seconds of each count, ascending.
    counts_s: Vec<f64>,
    /// Median distance of two counts in seconds, which holds before the first and after the last as
    /// well.
    period_s: f64,
    /// Place of the first count within its phrase.
    first: usize,
}

impl BeatPhase {
    /// Finds the counts from beats tracked at [`Rate::Beats`]. Bars and phrases begin where the
    /// harmony of `rows` (`[rows, 438]` at [`Rate::Conditioning`]) changes most. None without
    /// regular beats.
    #[must_use]
    pub fn find(beats: &Beats, rows: ArrayView2<'_, f32>) -> Option<Self> {
        let beats_s: Vec<f64> = beats.seconds().collect();
        if beats_s.len() < MIN_BEATS {
            return None;
        }
        let beat_s = median_distance(&beats_s);
        if beat_s <= 0.0 {
            return None;
        }
        let counts_s = in_octave(&beats_s, beat_s);
        let period_s = median_distance(&counts_s);
        if period_s <= 0.0 {
            // A few beats in one moment: thinned to a single count.
            return None;
        }
        let first = first_count(&changes(&counts_s, rows));
        Some(Self { counts_s, period_s, first })
    }

    /// Makes counts of a song's beats. Bars and phrases begin where first beats are most active and
    /// the harmony of `rows` (`[rows, 438]` at [`Rate::Conditioning`]) changes most; in three-four
    /// time a phrase begins with the first bar. None without beats.
    #[must_use]
    pub fn of(song: &SongBeats, rows: ArrayView2<'_, f32>) -> Option<Self> {
        let counts_s = counts_of(&song.beats_s);
        if song.metre == 3 {
            let start = song.downbeats_s.first()?;
            let first = counts_s.partition_point(|count| count < start) % PHRASE;
            return Self::from_counts(counts_s, (PHRASE - first) % PHRASE);
        }
        let mut active = [0.0; PHRASE];
        for (place, &count) in counts_s.iter().enumerate() {
            active[place % PHRASE] += song.downbeat_near(count);
        }
        let harmony = changes(&counts_s, rows);
        let [active_sum, harmony_sum] = [active, harmony].map(|sums| sums.iter().sum::<f64>());
        let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        let evidence = std::array::from_fn(|place| {
            share(active[place], active_sum) + HARMONY * share(harmony[place], harmony_sum)
        });
        Self::from_counts(counts_s, first_count(&evidence))
    }

    /// Makes counts of beats that are known: their seconds, ascending, and the place of the first
    /// within its bar or phrase. None below two beats, or where they do not ascend.
    ///
    /// ```
    /// use bailando_features::BeatPhase;
    ///
    /// // 100 beats a minute are 200 counts: the third beat of a bar is its fifth count.
    /// let beats_s: Vec<f64> = (0..20).map(|beat| f64::from(beat) * 0.6).collect();
    /// let counts = BeatPhase::of_beats(&beats_s, 2).unwrap();
    /// assert_eq!(counts.at(0.0), 4.0);
    /// assert_eq!(counts.at(1.2), 8.0);
    /// ```
    #[must_use]
    pub fn of_beats(beats_s: &[f64], place: usize) -> Option<Self> {
        if !beats_s.windows(2).all(|pair| pair[0] < pair[1]) {
            return None;
        }
        let octaves = octaves_above(beats_s)?;
        let first = match octaves >= 0 {
            true => (place % PHRASE) << octaves.min(MOST_OCTAVES),
            false => (place % PHRASE) >> (-octaves).min(MOST_OCTAVES),
        };
        Self::from_counts(counts_of(beats_s), first)
    }

    /// Takes counts that are known: their seconds, ascending, and the place of the first within its
    /// phrase of eight. None below two counts, or where they do not ascend.
    #[must_use]
    pub fn from_counts(counts_s: Vec<f64>, first: usize) -> Option<Self> {
        let ascends = counts_s.windows(2).all(|pair| pair[0] < pair[1]);
        let period_s = median_distance(&counts_s);
        (ascends && period_s > 0.0).then_some(Self { counts_s, period_s, first: first % PHRASE })
    }

    /// Returns the seconds of each count, ascending.
    #[must_use]
    pub fn counts_s(&self) -> &[f64] {
        &self.counts_s
    }

    /// Returns the counts since the start of a phrase before the song, at `seconds` from the song's
    /// start: a multiple of 8 at the start of a phrase.
    #[must_use]
    pub fn at(&self, seconds: f64) -> f64 {
        let after = self.counts_s.partition_point(|&count| count <= seconds);
        let (Some(&start), Some(&end)) = (self.counts_s.first(), self.counts_s.last()) else {
            return 0.0;
        };
        let counts = match after.checked_sub(1) {
            None => (seconds - start) / self.period_s,
            Some(before) => match (self.counts_s.get(before), self.counts_s.get(after)) {
                (Some(from), Some(to)) => before as f64 + (seconds - from) / (to - from),
                _ => before as f64 + (seconds - end) / self.period_s,
            },
        };
        counts + self.first as f64
    }

    /// Returns the seconds from the song's start at which so many counts have passed since the
    /// start of a phrase before the song: the inverse of [`BeatPhase::at`].
    #[must_use]
    pub fn second_of(&self, counts: f64) -> f64 {
        let place = counts - self.first as f64;
        let last = self.counts_s.len().saturating_sub(1);
        let before = (place.max(0.0) as usize).min(last.saturating_sub(1));
        match (self.counts_s.get(before), self.counts_s.get(before + 1)) {
            (Some(&from), Some(&to)) => {
                let within = place - before as f64;
                match (0.0..=1.0).contains(&within) {
                    true => from + within * (to - from),
                    false if within < 0.0 => from + within * self.period_s,
                    false => to + (within - 1.0) * self.period_s,
                }
            }
            _ => 0.0,
        }
    }

    /// Returns sine and cosine of the place within each of `periods` (in counts), `[rows, 2
    /// periods]`; row `k` lies `k` conditioning rows after `start_s`.
    #[must_use]
    pub fn columns(&self, rows: usize, start_s: f64, periods: &[u32]) -> Array2<f32> {
        let mut columns = Array2::zeros((rows, 2 * periods.len()));
        for (row, mut values) in columns.rows_mut().into_iter().enumerate() {
            let counts = self.at(start_s + row as f64 / Rate::Conditioning.rows_per_second());
            let angles = periods.iter().map(|&period| TAU * counts / f64::from(period.max(1)));
            let waves = angles.flat_map(|angle| [angle.sin(), angle.cos()]);
            for (value, wave) in values.iter_mut().zip(waves) {
                *value = wave as f32;
            }
        }
        columns
    }
}

/// Appends the columns of `periods` to feature rows `[rows, 438]` that begin `start_s` after the
/// song did: zeros without counts, nothing without periods.
#[must_use]
pub fn with_counts(
    rows: Array2<f32>,
    counts: Option<&BeatPhase>,
    start_s: f64,
    periods: &[u32],
) -> Array2<f32> {
    if periods.is_empty() {
        return rows;
    }
    let columns = match counts {
        Some(counts) => counts.columns(rows.nrows(), start_s, periods),
        None => Array2::zeros((rows.nrows(), 2 * periods.len())),
    };
    let width = rows.ncols();
    let shape = (rows.nrows(), width + columns.ncols());
    Array2::from_shape_fn(shape, |(row, column)| match column.checked_sub(width) {
        None => rows[[row, column]],
        Some(column) => columns[[row, column]],
    })
}

fn median_distance(times: &[f64]) -> f64 {
    let mut distances: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied().unwrap_or(0.0)
}

/// Divides or thins the beats by powers of two until they are counts.
fn in_octave(beats_s: &[f64], beat_s: f64) -> Vec<f64> {
    let longest = 60.0 / SLOWEST_COUNT_BPM;
    let (mut counts, mut distance) = (beats_s.to_vec(), beat_s);
    while distance > longest {
        let pairs = counts.windows(2);
        let halves = pairs.flat_map(|pair| [pair[0], (pair[0] + pair[1]) / 2.0]);
        counts = halves.chain(counts.last().copied()).collect();
        distance /= 2.0;
    }
    while distance <= longest / 2.0 {
        counts = counts.into_iter().step_by(2).collect();
        distance *= 2.0;
    }
    counts
}

/// Sums of the changes of harmony at the counts of each place in a phrase.
fn changes(counts_s: &[f64], rows: ArrayView2<'_, f32>) -> [f64; PHRASE] {
    let chroma = rows.slice_axis(Axis(1), Slice::from(CHROMA_COLUMNS));
    let mut changes = [0.0; PHRASE];
    for (place, &count) in counts_s.iter().enumerate() {
        changes[place % PHRASE] += novelty(chroma, count);
    }
    changes
}

/// Place of the first count within its phrase: the bar starts where the evidence of both its counts
/// in a phrase adds up to most, the phrase at the stronger of its two bars.
fn first_count(evidence: &[f64; PHRASE]) -> usize {
    let bar = |place: usize| evidence[place] + evidence[place + BAR];
    let start = (0..BAR).max_by(|&a, &b| bar(a).total_cmp(&bar(b)));
    let mut start = start.unwrap_or(0);
    if evidence[start] < evidence[start + BAR] {
        start += BAR;
    }
    (PHRASE - start) % PHRASE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::COLUMNS;

    const ROWS: usize = 225;

    /// Rows whose harmony changes every `bar_s`, first at `first_s`.
    fn rows(first_s: f64, bar_s: f64) -> Array2<f32> {
        Array2::from_shape_fn((ROWS, COLUMNS), |(row, column)| {
            let seconds = row as f64 / Rate::Conditioning.rows_per_second();
            let bar = ((seconds - first_s) / bar_s).floor().rem_euclid(3.0) as usize;
            let note = column.checked_sub(CHROMA_COLUMNS.start);
            if note == Some(4 * bar) { 1.0 } else { 0.1 }
        })
    }

    fn every(period_frames: f64, first: f64) -> Beats {
        let frames = (0..).map(|beat| first + f64::from(beat) * period_frames);
        Beats {
            tempo_bpm: 3_600.0 / period_frames,
            frames: frames
                .map(|frame| frame.round() as usize)
                .take_while(|&frame| frame < 1_750)
                .collect(),
        }
    }

    fn distance(counts: f64, period: f64) -> f64 {
        (counts - period * (counts / period).round()).abs()
    }

    #[test]
    fn counts_are_found_from_beats_twice_as_slow_or_fast_and_bars_from_harmony() {
        // 180 counts a minute are 20 frames each; bars of four begin at 0.5 s.
        let rows = rows(0.5, 4.0 / 3.0);
        for (period, first) in [(20.0, 10.0), (40.0, 10.0), (40.0, 30.0), (10.0, 10.0)] {
            let counts = BeatPhase::find(&every(period, first), rows.view()).unwrap();
            for bar in 0..18 {
                let seconds = 0.5 + f64::from(bar) * 4.0 / 3.0;
                let phase = counts.at(seconds);
                assert!(distance(phase, 4.0) < 0.15, "{period} {first}: {phase}");
                let later = counts.at(seconds + 1.0 / 3.0);
                let step = later - phase;
                assert!((step - 1.0).abs() < 0.1, "{period}: {phase} {later}");
            }
            for counted in [-3.5, 0.25, 17.0, 90.0] {
                let seconds = counts.second_of(counted);
                assert!((counts.at(seconds) - counted).abs() < 1e-9, "{period}: {counted}");
            }
            // Before the first and after the last beat as well.
            assert!(distance(counts.at(0.5 - 4.0 / 3.0), 4.0) < 0.15);
            assert!(distance(counts.at(0.5 + 40.0), 4.0) < 0.3);
        }
    }

    #[test]
    fn columns_are_sines_and_cosines_and_move_with_the_start() {
        let rows = rows(0.5, 4.0 / 3.0);
        let counts = BeatPhase::find(&every(20.0, 10.0), rows.view()).unwrap();
        let columns = counts.columns(20, 0.0, &[1, 4]);
        assert_eq!(columns.dim(), (20, 4));
        for (row, values) in columns.rows().into_iter().enumerate() {
            let phase = counts.at(row as f64 / 7.5);
            for (place, period) in [(0, 1.0), (2, 4.0)] {
                let angle = (TAU * phase / period) as f32;
                assert!((values[place] - angle.sin()).abs() < 1e-4);
                assert!((values[place + 1] - angle.cos()).abs() < 1e-4);
            }
        }
        let later = counts.columns(10, 3.0 / 7.5, &[1, 4]);
        let difference = |(row, column): (usize, usize)| {
            (later[[row, column]] - columns[[row + 3, column]]).abs()
        };
        assert!((0..10).all(|row| (0..4).all(|column| difference((row, column)) < 1e-4)));
    }

    #[test]
    fn known_counts_are_taken_as_they_are() {
        let counts_s: Vec<f64> = (0..20).map(|count| 0.25 + f64::from(count) * 0.4).collect();
        let phase = BeatPhase::from_counts(counts_s, 12).unwrap();
        assert!((phase.at(0.25) - 4.0).abs() < 1e-9 && (phase.at(2.05) - 8.5).abs() < 1e-9);
        for wrong in [vec![], vec![1.0], vec![1.0, 1.0], vec![2.0, 1.0, 3.0]] {
            assert_eq!(BeatPhase::from_counts(wrong, 0), None);
        }
    }

    #[test]
    fn bars_of_three_begin_with_the_first_downbeat() {
        let rows = rows(0.5, 1.0);
        let beats_s: Vec<f64> = (0..30).map(|beat| f64::from(beat) * 0.6).collect();
        let downbeats_s = beats_s.iter().skip(1).step_by(3).copied().collect();
        let song = SongBeats { beats_s, downbeats_s, metre: 3, ..SongBeats::default() };
        let phase = BeatPhase::of(&song, rows.view()).unwrap();
        assert!(distance(phase.at(0.6), 8.0) < 1e-9);
        assert!((phase.at(2.4) - phase.at(0.6) - 6.0).abs() < 1e-9);
        assert_eq!(BeatPhase::of(&SongBeats::default(), rows.view()), None);
    }

    #[test]
    fn without_regular_beats_there_are_zeros() {
        let rows = rows(0.5, 1.0);
        // The last ones are thinned into the octave to a single count.
        for frames in [vec![], vec![10, 20, 30], vec![10; 9], vec![10, 11, 12, 13]] {
            let tempo_bpm = 0.0;
            let beats = Beats { tempo_bpm, frames };
            assert_eq!(BeatPhase::find(&beats, rows.view()), None);
        }
        let wide = with_counts(rows.clone(), None, 0.0, &[1, 2, 4]);
        assert_eq!(wide.dim(), (ROWS, COLUMNS + 6));
        let added = wide.slice_axis(Axis(1), Slice::from(-6..));
        assert!(added.iter().all(|&value| value == 0.0));
        assert_eq!(with_counts(rows.clone(), None, 0.0, &[]), rows);
    }
}
