//! Sections of a song that return.

use ndarray::ArrayView2;

use super::{phrases::Phrases, similarity::SelfSimilarity};
use crate::phase::BeatPhase;

/// Counts of a phrase.
const PHRASE: usize = 8;
/// Likeness from which on two phrases are the same music.
const SAME: f64 = 0.5;
/// Phrases for which music must have been away: what goes round and round does not return.
const AWAY: usize = 4;
/// Fewest phrases of a section.
const FEWEST: usize = 2;

/// A section of a song that was there before: whole phrases of eight counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// Second of its first count.
    pub start_s: f64,
    /// Second of its end.
    pub end_s: f64,
    /// Seconds from the same music before to this one.
    pub lag_s: f64,
    /// Second of the first count of the bar before it.
    pub bar_before_s: f64,
}

/// Finds the sections that return in a song of `rows` (`[rows, 438 or more]` at
/// [`Rate::Conditioning`](crate::Rate::Conditioning)): they do not overlap, and ascend.
#[must_use]
pub fn returns(rows: ArrayView2<'_, f32>, counts: &BeatPhase) -> Vec<Return> {
    let phrases = Phrases::new(rows, counts, PHRASE);
    let bounds = phrases.bounds_s();
    let stripes = chosen(stripes(&phrases.self_similarity()));
    let of_stripe = |Stripe { start, end, lag, .. }: Stripe| {
        let lags = (start..end).map(|phrase| bounds[phrase] - bounds[phrase - lag]);
        Return {
            start_s: bounds[start],
            end_s: bounds[end],
            lag_s: lags.sum::<f64>() / (end - start) as f64,
            bar_before_s: (bounds[start - 1] + bounds[start]) / 2.0,
        }
    };
    stripes.into_iter().map(of_stripe).collect()
}

/// Phrases from `start` to `end` that are each like the one `lag` phrases before.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stripe {
    start: usize,
    end: usize,
    lag: usize,
    /// Sum of the likenesses.
    weight: f64,
}

/// All stripes that begin where music returns.
fn stripes(similar: &SelfSimilarity) -> Vec<Stripe> {
    let number = similar.parts();
    let mut stripes = Vec::new();
    for lag in AWAY + 1..number {
        let mut start = lag;
        while start < number {
            let end = stripe_end(similar, start, lag);
            if end >= start + FEWEST && was_away(similar, start, end) {
                let weight = (start..end).map(|phrase| similar.of(phrase, phrase - lag)).sum();
                stripes.push(Stripe { start, end, lag, weight });
            }
            start = end + 1;
        }
    }
    stripes
}

/// The end of the stripe from `start` on, at most `lag` long, or `start`; one phrase in between may
/// be another, as where a section's last phrase leads elsewhere.
fn stripe_end(similar: &SelfSimilarity, start: usize, lag: usize) -> usize {
    let most = similar.parts().min(start + lag);
    let is_same = |phrase: usize| phrase < most && similar.of(phrase, phrase - lag) >= SAME;
    let mut end = start;
    loop {
        end += match (is_same(end), end > start && is_same(end + 1)) {
            (true, _) => 1,
            (false, true) => 2,
            (false, false) => return end,
        };
    }
}

/// Whether the first phrases are unlike those just before.
fn was_away(similar: &SelfSimilarity, start: usize, end: usize) -> bool {
    let first = start..end.min(start + AWAY);
    let count = first.len() as f64;
    let nearest = first.map(|phrase| {
        let before = start.saturating_sub(AWAY)..start;
        before.map(|before| similar.of(phrase, before)).fold(-1.0, f64::max)
    });
    nearest.sum::<f64>() / count < SAME
}

/// The stripes with most in common, no two of them for the same phrases.
fn chosen(mut stripes: Vec<Stripe>) -> Vec<Stripe> {
    stripes.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(b.lag.cmp(&a.lag)));
    let mut chosen: Vec<Stripe> = Vec::new();
    for stripe in stripes {
        let is_apart = |other: &Stripe| stripe.end <= other.start || other.end <= stripe.start;
        if chosen.iter().all(is_apart) {
            chosen.push(stripe);
        }
    }
    chosen.sort_by_key(|stripe| stripe.start);
    chosen
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3};

    use super::*;
    use crate::layout::{COLUMNS, Rate};

    /// Seconds of a count: 180 a minute.
    const COUNT_S: f64 = 1.0 / 3.0;
    /// Second of the first phrase.
    const FIRST_S: f64 = 0.5;

    /// A number for each phrase of a song, count and column; sections of a letter are four phrases.
    fn sound(form: &str, phrase: usize, count: usize, column: usize) -> f32 {
        let Some(section) = form.chars().nth(phrase / 4) else { return 0.0 };
        let place = match section {
            // Phrases of a loop are all the same.
            'l' => 0,
            _ => phrase % 4,
        };
        let seed = (section as usize * 7 + place) * 1_009 + count * 131 + column * 17;
        // A hash that spreads over -1 to 1.
        ((seed as f64 * 12.989_8).sin() * 43_758.547).fract() as f32
    }

    fn found(form: &str) -> Vec<[f64; 3]> {
        let phrase_s = 8.0 * COUNT_S;
        let seconds = FIRST_S + form.len() as f64 * 4.0 * phrase_s;
        let rate = Rate::Conditioning.rows_per_second();
        let rows = (seconds * rate).ceil() as usize;
        let rows = Array2::from_shape_fn((rows, COLUMNS), |(row, column)| {
            let counts = (row as f64 / rate - FIRST_S) / COUNT_S;
            match counts < 0.0 {
                true => 0.0,
                false => sound(form, counts as usize / 8, counts as usize % 8, column),
            }
        });
        let counts_s = (0..32 * form.len()).map(|count| FIRST_S + count as f64 * COUNT_S);
        let counts = BeatPhase::from_counts(counts_s.collect(), 0).unwrap();
        let found = returns(rows.view(), &counts).into_iter();
        let phrases = |seconds: f64| (seconds / phrase_s * 100.0).round() / 100.0;
        let whole = |found: Return| {
            assert!((found.start_s - found.bar_before_s - 4.0 * COUNT_S).abs() < 1e-9);
            [found.start_s - FIRST_S, found.end_s - FIRST_S, found.lag_s].map(phrases)
        };
        found.map(whole).collect()
    }

    #[test]
    fn a_section_returns_after_another() {
        assert_eq!(found("abab"), [[8.0, 16.0, 8.0]]);
        assert_eq!(found("aba"), [[8.0, 12.0, 8.0]]);
        assert_eq!(found("abcb"), [[12.0, 16.0, 8.0]]);
        assert_eq!(found("abcdab"), [[16.0, 24.0, 16.0]]);
    }

    #[test]
    fn what_goes_on_does_not_return() {
        assert!(found("abcd").is_empty() && found("a").is_empty());
        // The second a follows at once.
        let [[start, end, _]] = found("aaba")[..] else { panic!("one section returns") };
        assert_eq!((start, end), (12.0, 16.0));
        assert!(found("llll").is_empty());
        assert_eq!(found("llabll"), [[16.0, 24.0, 16.0]]);
    }

    #[test]
    fn one_other_phrase_does_not_end_a_section() {
        let mut parts = Array3::from_shape_fn((16, 8, 4), |(phrase, count, column)| {
            sound("abab", phrase, count, column)
        });
        let find = |parts: &Array3<f32>| chosen(stripes(&SelfSimilarity::new(parts)));
        let ends = |parts: &Array3<f32>| {
            let found = find(parts).into_iter();
            found.map(|stripe| (stripe.start, stripe.end)).collect::<Vec<_>>()
        };
        assert_eq!(ends(&parts), [(8, 16)]);
        for phrase in [10, 15] {
            for ((count, column), value) in
                parts.index_axis_mut(ndarray::Axis(0), phrase).indexed_iter_mut()
            {
                *value = sound("z", phrase % 4, count, column);
            }
        }
        assert_eq!(ends(&parts), [(8, 15)]);
    }
}
