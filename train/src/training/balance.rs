//! Weights of the windows that a stage draws: by style, by phrase, by how much is worth learning.

use std::{collections::HashMap, hash::Hash, ops::Range};

use super::{config::BalanceConfig, piece::MotionPiece};

/// Returns a weight for each window, given as a motion and a first frame; `None` where all are
/// alike, so that every window is drawn once a round.
pub(super) fn window_weights(
    balance: &BalanceConfig,
    pieces: &[MotionPiece],
    windows: &[(usize, usize)],
    frames: usize,
) -> Option<Vec<f64>> {
    let of_folder = |&(dance, _): &(usize, usize)| pieces[dance].facts().weight;
    let worth = |window: &(usize, usize)| {
        let (piece, frames) = (&pieces[window.0], window.1..window.1 + frames);
        worth(balance, piece, frames)
    };
    let mut weights: Vec<f64> = windows.iter().map(worth).collect();
    // The middle of a window says which phrase it is about.
    let phrases = windows.iter().map(|&(dance, start)| {
        let phrase = pieces[dance].facts().marks.phrase_at(start + frames / 2);
        phrase.map(|phrase| (pieces[dance].facts().style, &phrase.name))
    });
    level(&mut weights, &phrases.collect::<Vec<_>>(), balance.phrases);
    let styles = windows.iter().map(|&(dance, _)| Some(pieces[dance].facts().style));
    level(&mut weights, &styles.collect::<Vec<_>>(), balance.styles);
    for (weight, window) in weights.iter_mut().zip(windows) {
        *weight *= of_folder(window);
    }
    let alike = weights.windows(2).all(|pair| pair[0] == pair[1]);
    (!alike && weights.iter().sum::<f64>() > 0.0).then_some(weights)
}

/// Returns how much of a window is worth learning.
fn worth(balance: &BalanceConfig, piece: &MotionPiece, frames: Range<usize>) -> f64 {
    let still = match balance.still {
        1.0 => 1.0,
        weight => 1.0 - (1.0 - weight) * piece.slow_share(frames.clone()),
    };
    let damaged = piece.facts().marks.damaged_share(frames);
    still * (1.0 - (1.0 - balance.damaged) * damaged)
}

/// Brings the total weight of every group nearer to the others': it is divided by its power of
/// `exponent`, 0 leaves it and 1 makes all the same. What is in no group stays.
fn level<G: Eq + Hash>(weights: &mut [f64], groups: &[Option<G>], exponent: f64) {
    if exponent == 0.0 {
        return;
    }
    let mut totals: HashMap<&G, (f64, usize)> = HashMap::new();
    for (&weight, group) in weights.iter().zip(groups) {
        if let Some(group) = group {
            let (total, count) = totals.entry(group).or_default();
            *total += weight;
            *count += 1;
        }
    }
    // As much in all groups together as before, beside what is in none.
    let before: f64 = totals.values().map(|&(total, _)| total).sum();
    let after: f64 = totals.values().map(|&(total, _)| total.powf(1.0 - exponent)).sum();
    for (weight, group) in weights.iter_mut().zip(groups) {
        let total = group.as_ref().and_then(|group| totals.get(group));
        if let Some(&(total, _)) = total.filter(|(total, _)| *total > 0.0) {
            *weight *= total.powf(-exponent) * before / after;
        }
    }
}

#[cfg(test)]
mod tests {
    use bailando::motion::{MotionFrame, Positions};

    use super::*;
    use crate::{
        data::{JOINTS, Marks, Phrase, testing},
        export::skeleton,
        training::piece::PieceFacts,
    };

    const WINDOW: usize = 20;
    const AS_PUBLISHED: BalanceConfig =
        BalanceConfig { styles: 0.0, phrases: 0.0, still: 1.0, damaged: 1.0 };

    fn piece(frames: usize, facts: PieceFacts) -> MotionPiece {
        let positions = testing::dance(&skeleton(0.93), frames, 1);
        MotionPiece::from_positions(positions, MotionFrame::Dancer).unwrap().with_facts(facts)
    }

    fn of_style(style: usize) -> PieceFacts {
        PieceFacts { style: Some(style), ..PieceFacts::default() }
    }

    /// All windows of the pieces, 10 frames after another.
    fn windows(pieces: &[MotionPiece]) -> Vec<(usize, usize)> {
        let pieces = pieces.iter().enumerate();
        let windows = pieces.flat_map(|(dance, piece)| {
            (0..=piece.frames() - WINDOW).step_by(10).map(move |start| (dance, start))
        });
        windows.collect()
    }

    /// Sums of the weights of each piece.
    fn sums(balance: &BalanceConfig, pieces: &[MotionPiece]) -> Vec<f64> {
        let windows = windows(pieces);
        let weights = window_weights(balance, pieces, &windows, WINDOW).unwrap();
        let sum = |dance| {
            let weights = windows.iter().zip(&weights);
            weights.filter(|((of, _), _)| *of == dance).map(|(_, weight)| weight).sum()
        };
        (0..pieces.len()).map(sum).collect()
    }

    fn assert_close(found: &[f64], wanted: &[f64]) {
        let close = found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-6);
        assert!(close && found.len() == wanted.len(), "{found:?} {wanted:?}");
    }

    #[test]
    fn as_published_every_window_is_drawn_alike() {
        let pieces = [piece(110, of_style(0)), piece(50, of_style(1))];
        let windows = windows(&pieces);
        assert_eq!(window_weights(&AS_PUBLISHED, &pieces, &windows, WINDOW), None);
        let one_style = BalanceConfig { styles: 1.0, ..AS_PUBLISHED };
        let (pieces, windows) = (&pieces[..1], &windows[..10]);
        assert_eq!(window_weights(&one_style, pieces, windows, WINDOW), None);
    }

    #[test]
    fn styles_and_folders_are_balanced() {
        // 10, 10 and 4 windows.
        let heavy = PieceFacts { weight: 2.0, ..of_style(1) };
        let pieces = [piece(110, of_style(0)), piece(110, of_style(0)), piece(50, heavy)];
        assert_close(&sums(&AS_PUBLISHED, &pieces), &[10.0, 10.0, 8.0]);
        let alike = BalanceConfig { styles: 1.0, ..AS_PUBLISHED };
        assert_close(&sums(&alike, &pieces), &[6.0, 6.0, 24.0]);
        let between = BalanceConfig { styles: 0.5, ..AS_PUBLISHED };
        let found = sums(&between, &pieces);
        assert_close(&[found[2] / (found[0] + found[1])], &[2.0 * (4.0_f64 / 20.0).sqrt()]);
    }

    #[test]
    fn a_phrase_that_stands_twice_counts_once() {
        let phrases = |names: [&str; 2]| {
            let phrase =
                |(start_frame, name): (usize, &str)| Phrase { start_frame, name: name.to_owned() };
            let phrases = [(0, names[0]), (60, names[1])].map(phrase).into();
            PieceFacts { marks: Marks { phrases, ..Marks::default() }, ..PieceFacts::default() }
        };
        // The middle of a window is 10 after its start: five windows of each phrase.
        let pieces = [piece(110, phrases(["a", "b"])), piece(110, phrases(["a", "c"]))];
        let balance = BalanceConfig { phrases: 1.0, ..AS_PUBLISHED };
        let windows = windows(&pieces);
        let weights = window_weights(&balance, &pieces, &windows, WINDOW).unwrap();
        let sum = |range: Range<usize>| weights[range].iter().sum::<f64>();
        let third = 20.0 / 3.0;
        assert_close(&[sum(0..5) + sum(10..15), sum(5..10), sum(15..20)], &[third; 3]);
    }

    #[test]
    fn still_and_damaged_windows_are_drawn_less() {
        let still =
            MotionPiece::from_positions(Positions::zeros((110, JOINTS, 3)), MotionFrame::World);
        let damaged = PieceFacts {
            marks: Marks { damaged: std::iter::once(0..20).collect(), ..Marks::default() },
            ..PieceFacts::default()
        };
        let pieces = [piece(110, damaged), still.unwrap()];
        let windows = [(0, 0), (0, 10), (0, 50), (1, 0)];
        let balance = BalanceConfig { still: 0.25, damaged: 0.0, ..AS_PUBLISHED };
        let weights = window_weights(&balance, &pieces, &windows, WINDOW).unwrap();
        assert_close(&weights, &[0.0, 0.5, 1.0, 0.25]);
    }
}
