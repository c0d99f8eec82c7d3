//! Other music for a window: phrases fit any song of their style and tempo from a bar's start on.

use bailando::features::BeatPhase;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::piece::MotionPiece;
use crate::data::{Draw, FPS, FRAMES_PER_CODE};

/// Counts of the longest period that models are conditioned on: a bar of four beats, or two bars
/// where a beat is one count.
const PHRASE: f64 = 8.0;
/// Largest difference of two tempos: over a window of four seconds less than a frame and a half
/// either way of its middle.
const SAME_TEMPO: f64 = 0.01;
/// Most frames by which a bar may lie beside the place that it takes.
const BESIDE: f64 = 1.0;

/// Phrases of eight counts of a song, in frames.
struct Counted {
    starts: Vec<f64>,
    length: f64,
}

impl Counted {
    /// Returns the phrases of a motion's songs; `None` where the data have no beats.
    fn of(piece: &MotionPiece) -> Option<Self> {
        let facts = piece.facts();
        let place = facts.marks.first_count.saturating_sub(1);
        let counts = BeatPhase::of_beats(&facts.grid_beats_s, place)?;
        let (first, last) = (*counts.counts_s().first()?, *counts.counts_s().last()?);
        let frame = |phrase: u32| counts.second_of(PHRASE * f64::from(phrase)) * FPS as f64;
        let starts = (0..).map(frame).take_while(|&start| start <= last * FPS as f64);
        let starts: Vec<f64> = starts.filter(|&start| start >= first * FPS as f64).collect();
        let number = counts.counts_s().len().checked_sub(1)?;
        let length = PHRASE * (last - first) * FPS as f64 / number as f64;
        Some(Self { starts, length })
    }

    /// Returns the place of a frame in its phrase, in frames.
    fn place(&self, frame: f64) -> Option<f64> {
        let after = self.starts.partition_point(|&start| start <= frame);
        Some(frame - self.starts.get(after.checked_sub(1)?)?)
    }
}

/// Draws music for a window of `block` codes: motion, song, start phase and row beside the first
/// code of a place in the same style, at the same tempo and place in the bar. `None` for a motion
/// that is not made of phrases.
pub(super) fn other_music(
    window: &Draw,
    pieces: &[MotionPiece],
    block: usize,
    random: &mut ChaCha8Rng,
) -> Option<[usize; 4]> {
    let own = &pieces[window.dance];
    if own.facts().marks.phrases.is_empty() {
        return None;
    }
    let counted = Counted::of(own)?;
    // Of the window's middle.
    let middle = (block * FRAMES_PER_CODE) as f64 / 2.0;
    let place = counted.place((window.phase + window.start) as f64 + middle)?;
    let mut found = Vec::new();
    for (dance, piece) in pieces.iter().enumerate() {
        if piece.facts().style != own.facts().style {
            continue;
        }
        let Some(other) = Counted::of(piece) else { continue };
        if (other.length / counted.length - 1.0).abs() > SAME_TEMPO {
            continue;
        }
        let rows = piece.frames_with_music() / FRAMES_PER_CODE + 1;
        for start in &other.starts {
            let frame = start + place * other.length / counted.length - middle;
            for phase in 0..piece.phases(usize::MAX) {
                let codes = ((frame - phase as f64) / FRAMES_PER_CODE as f64).round();
                let beside = phase as f64 + codes * FRAMES_PER_CODE as f64 - frame;
                // The last start phases have a row less.
                let fits = codes >= 0.0 && codes as usize + block + 1 < rows;
                if fits && beside.abs() <= BESIDE {
                    found.push([dance, phase, codes as usize + 1]);
                }
            }
        }
    }
    let &[dance, phase, row] = found.get(random.random_range(0..found.len().max(1)))?;
    let song = random.random_range(0..pieces[dance].songs().len().max(1));
    Some([dance, song, phase, row])
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use bailando::motion::MotionFrame;
    use ndarray::Array2;

    use super::*;
    use crate::{
        data::{Marks, Phrase, testing},
        export::skeleton,
        training::{piece::PieceFacts, songs::SongRows, windows::generator},
    };

    const FRAMES: usize = 900;

    /// A motion with two songs of beats every `beat` frames from `first` on, in `phases` phases.
    fn piece(style: usize, beat: f64, first: f64, phases: usize) -> MotionPiece {
        let positions = testing::dance(&skeleton(0.93), FRAMES, 1);
        let phrase = Phrase { start_frame: 0, name: "a".into() };
        let marks = Marks { phrases: vec![phrase], first_count: 1, ..Marks::default() };
        let beats = (0..60).map(|number| (first + f64::from(number) * beat) / FPS as f64);
        let grid_beats_s = beats.take_while(|&beat| beat < FRAMES as f64 / FPS as f64).collect();
        let facts = PieceFacts { style: Some(style), marks, grid_beats_s, weight: 1.0 };
        let rows = |phase| Arc::new(Array2::zeros((1 + (FRAMES - phase) / 8, 1)));
        let song = || SongRows::new((0..phases).map(rows).collect()).unwrap();
        let piece = MotionPiece::from_positions(positions, MotionFrame::Dancer).unwrap();
        piece.with_facts(facts).with_song(song()).with_song(song())
    }

    #[test]
    fn other_music_has_the_same_style_tempo_and_place_in_the_bar() {
        let pieces = [
            piece(0, 30.0, 0.0, 8),
            piece(0, 30.1, 13.0, 8),
            piece(0, 33.0, 0.0, 8),
            piece(1, 30.0, 0.0, 8),
            piece(0, 30.0, 5.0, 1),
        ];
        let random = &mut generator(3, 4);
        let mut from = [0; 5];
        for start in (0..600).step_by(8) {
            let window = Draw { phase: 3, start, ..Draw::default() };
            let [dance, song, phase, row] = other_music(&window, &pieces, 29, random).unwrap();
            from[dance] += 1;
            assert!(song < 2 && phase < pieces[dance].phases(8));
            assert!(row + 29 <= pieces[dance].songs()[song].phase(phase).nrows());
            let place = |dance: usize, frame: usize| {
                Counted::of(&pieces[dance]).unwrap().place(frame as f64).unwrap()
            };
            // Row k + 1 is beside code k.
            let moved = phase + 8 * (row - 1);
            let apart = place(dance, moved + 116) - place(0, start + 3 + 116);
            let bar = 120.0;
            assert!(apart.rem_euclid(bar).min((-apart).rem_euclid(bar)) < 1.6, "{apart}");
        }
        assert!(from[0] > 0 && from[1] > 0 && from[4] > 0, "{from:?}");
        assert_eq!(from[2] + from[3], 0);
    }

    #[test]
    fn fast_beats_are_counts_of_phrases_of_two_bars() {
        let pieces = [piece(0, 26.0, 0.0, 8)];
        let random = &mut generator(3, 4);
        for start in (0..600).step_by(8) {
            let window = Draw { phase: 3, start, ..Draw::default() };
            let [_, _, phase, row] = other_music(&window, &pieces, 29, random).unwrap();
            let apart = (phase + 8 * (row - 1)) as f64 - (3 + start) as f64;
            let phrase = 208.0;
            assert!(apart.rem_euclid(phrase).min((-apart).rem_euclid(phrase)) < 1.6, "{apart}");
        }
    }

    #[test]
    fn without_phrases_or_beats_a_window_keeps_its_music() {
        let plain = piece(0, 30.0, 0.0, 1);
        let none = plain.clone().with_facts(PieceFacts::default());
        let random = &mut generator(3, 4);
        assert_eq!(other_music(&Draw::default(), &[none], 29, random), None);
        // Before the first bar there is no place in one.
        let late = piece(0, 30.0, 200.0, 1);
        assert_eq!(other_music(&Draw::default(), &[late], 29, random), None);
    }
}
