//! From activations to beats: the likelier of bars of three and of four (BEATS, HMM).

use super::hmm::{Activation, BarModel, Beat, Path};

/// Activation below which frames at either end are left out.
const AUDIBLE: f32 = 0.05;
/// Beats of a bar.
const METRES: [usize; 2] = [3, 4];
/// Frames of the fastest and the slowest beat: 215 and 55 a minute at 50 frames a second.
const SHORTEST: usize = 14;
const LONGEST: usize = 55;

/// Decoder of a song's beats.
#[derive(Debug)]
pub(super) struct Decoder {
    models: Vec<BarModel>,
}

impl Decoder {
    /// A decoder of bars of three or four beats, 55 to 215 a minute.
    pub(super) fn new() -> Self {
        Self::of(&METRES, SHORTEST, LONGEST)
    }

    /// A decoder of bars of these lengths, whose beats have from `shortest` to `longest` frames.
    pub(super) fn of(metres: &[usize], shortest: usize, longest: usize) -> Self {
        let model = |&metre| BarModel::new(metre, shortest, longest);
        Self { models: metres.iter().map(model).collect() }
    }

    /// Finds the beats, and how many of them make a bar; none where nothing is active.
    pub(super) fn beats(&self, activations: &[Activation]) -> (Vec<Beat>, usize) {
        let is_audible = |a: &Activation| a.any() >= AUDIBLE;
        let first = activations.iter().position(is_audible);
        let Some((first, last)) = first.zip(activations.iter().rposition(is_audible)) else {
            return (Vec::new(), 0);
        };
        let paths = self.models.iter().map(|model| {
            let path = model.best_path(&activations[first..=last]);
            (path, model.metre())
        });
        // The shorter bar of equals.
        let likelier = |best: (Path, usize), next: (Path, usize)| {
            let is_likelier = next.0.log_probability > best.0.log_probability;
            if is_likelier { next } else { best }
        };
        paths.reduce(likelier).map_or((Vec::new(), 0), |(path, metre)| {
            let beats = path.beats.into_iter();
            (beats.map(|beat| Beat { frame: beat.frame + first, ..beat }).collect(), metre)
        })
    }
}
