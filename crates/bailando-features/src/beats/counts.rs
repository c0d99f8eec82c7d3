//! Counts: beats, halved or doubled into the dancer's octave (BEATS, counts).

/// Slowest counts per minute of the octave from it to its double: dancers count neither slower nor
/// faster.
const SLOWEST_COUNT_BPM: f64 = 130.0;
/// Share by which a regular distance differs from the median.
const REGULAR: f64 = 0.25;
/// Most counts between two beats: longer pauses have no counts of their own.
const MOST: f64 = 32.0;

/// Returns the seconds of the counts of beats, ascending; none below two beats.
pub(crate) fn counts_of(beats_s: &[f64]) -> Vec<f64> {
    let Some(beat_s) = regular_distance(beats_s) else { return Vec::new() };
    let octaves = octaves_of(beat_s);
    let count_s = beat_s / octaves.exp2();
    if octaves < 0.0 {
        return beats_s.iter().step_by((-octaves).exp2() as usize).copied().collect();
    }
    let mut counts = Vec::new();
    for pair in beats_s.windows(2) {
        // By the beat's own distance: the tempo may change.
        let parts = ((pair[1] - pair[0]) / count_s).log2().round().exp2().clamp(1.0, MOST);
        let step = (pair[1] - pair[0]) / parts;
        counts.extend((0..parts as usize).map(|part| pair[0] + part as f64 * step));
    }
    counts.extend(beats_s.last());
    counts
}

/// Returns how many octaves counts lie above their beats: a beat holds 2 to this power of them;
/// none below two beats.
pub(crate) fn octaves_above(beats_s: &[f64]) -> Option<i32> {
    regular_distance(beats_s).map(|beat_s| octaves_of(beat_s) as i32)
}

/// A beat holds 1, 2, 4, .. counts, or is one of 2, 4, .. that make a count.
fn octaves_of(beat_s: f64) -> f64 {
    let longest = 60.0 / SLOWEST_COUNT_BPM;
    (beat_s / longest).log2().ceil()
}

/// The mean of the distances that are near to the median: the median alone is a whole number of
/// frames, and may lie in another octave.
fn regular_distance(beats_s: &[f64]) -> Option<f64> {
    let mut distances: Vec<f64> = beats_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    distances.sort_by(f64::total_cmp);
    let median = distances.get(distances.len() / 2).copied().filter(|&median| median > 0.0)?;
    distances.retain(|distance| (distance / median - 1.0).abs() <= REGULAR);
    Some(distances.iter().sum::<f64>() / distances.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beats(count: usize, distance: f64) -> Vec<f64> {
        (0..count).map(|k| 0.5 + k as f64 * distance).collect()
    }

    #[test]
    fn counts_lie_in_the_octave_from_130_a_minute() {
        for (bpm, expected) in [(66.0, 132.0), (90.0, 180.0), (128.0, 256.0), (131.0, 131.0)] {
            let counts = counts_of(&beats(30, 60.0 / bpm));
            let found = 60.0 / (counts[1] - counts[0]);
            assert!((found - expected).abs() < 1e-6, "{bpm}: {found}");
            assert!((counts[counts.len() - 1] - 0.5 - 29.0 * 60.0 / bpm).abs() < 1e-9);
        }
        for (bpm, expected) in [(50.0, 200.0), (300.0, 150.0), (529.0, 132.25)] {
            let counts = counts_of(&beats(30, 60.0 / bpm));
            assert!((60.0 / (counts[1] - counts[0]) - expected).abs() < 1e-6, "{bpm}");
        }
    }

    #[test]
    fn distances_of_whole_frames_do_not_change_the_octave() {
        // 128 a minute at 50 frames a second: most distances are 0.46 s, 130 a minute and more.
        let framed = (0..60).map(|k| (f64::from(k) * 60.0 / 128.0 * 50.0).round() / 50.0);
        let counts = counts_of(&framed.collect::<Vec<_>>());
        assert_eq!(counts.len(), 2 * 59 + 1);
    }

    #[test]
    fn a_slower_part_has_its_own_counts() {
        let mut slow = beats(10, 0.75);
        let start = slow[9];
        slow.extend((1..20).map(|k| start + f64::from(k) * 60.0 / 140.0));
        let counts = counts_of(&slow);
        assert_eq!(counts.len(), 2 * 9 + 19 + 1);
    }

    #[test]
    fn single_and_equal_beats_have_no_counts() {
        assert!(counts_of(&[]).is_empty() && counts_of(&[1.0]).is_empty());
        assert!(counts_of(&[1.0, 1.0, 1.0]).is_empty());
    }
}
