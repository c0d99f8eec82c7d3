//! Numbers of beats within the bar where the network tells none: by loudness.
//!
//! A click of a metronome is a first beat to the network, whichever it is: at 0.86 and more, while
//! the other beats of music are below 0.6 as such, and its first beats at least 0.1 above them.

use super::hmm::{Activation, Beat};

/// Difference of the activations of first and other beats below which the network knows no bars.
const TOLD: f64 = 0.06;
/// Activation of the other beats as first ones from which on all seem to be.
const ALL: f64 = 0.7;
/// Share of the accents' variance that bars of three explain, from which on they are believed.
const EXPLAINED: f64 = 0.15;
/// Frames around a beat whose rises are its accent.
const BEFORE: usize = 2;
const AFTER: usize = 4;

/// Whether first beats are more active as such than the others.
pub(super) fn are_told(beats: &[Beat], activations: &[Activation]) -> bool {
    let mean = |is_first: bool| {
        let those = beats.iter().filter(|beat| (beat.number == 1) == is_first);
        let (sum, count) = those.fold((0.0, 0), |(sum, count), beat| {
            (sum + f64::from(activations[beat.frame].downbeat), count + 1)
        });
        sum / f64::from(count.max(1))
    };
    let others = mean(false);
    others < ALL && mean(true) - others >= TOLD
}

/// Numbers the beats by their accents, `rises` being the rise of all bands in each frame; gives the
/// beats of a bar: three where accents say so, else four.
pub(super) fn number_by_accent(beats: &mut [Beat], rises: &[f32]) -> usize {
    let accent = |beat: &Beat| {
        let frames = beat.frame.saturating_sub(BEFORE)..(beat.frame + AFTER).min(rises.len());
        rises[frames].iter().map(|&rise| f64::from(rise)).sum()
    };
    let accents: Vec<f64> = beats.iter().map(accent).collect();
    let three = explained(&accents, 3);
    let metre = if three >= EXPLAINED && three > explained(&accents, 4) { 3 } else { 4 };
    let means = means(&accents, metre);
    // The first of equals.
    let strongest = (0..metre).rev().max_by(|&a, &b| means[a].total_cmp(&means[b])).unwrap_or(0);
    for (place, beat) in beats.iter_mut().enumerate() {
        beat.number = (place + metre - strongest) % metre + 1;
    }
    metre
}

/// Mean accent of the places of a bar.
fn means(accents: &[f64], metre: usize) -> Vec<f64> {
    let mean = |place: usize| {
        let those = accents.iter().skip(place).step_by(metre);
        those.clone().sum::<f64>() / those.len().max(1) as f64
    };
    (0..metre).map(mean).collect()
}

/// Share of the accents' variance that lies between the places of a bar, adjusted for their number.
fn explained(accents: &[f64], metre: usize) -> f64 {
    let means = means(accents, metre);
    let squares = |error: &dyn Fn(usize, f64) -> f64| {
        accents.iter().enumerate().map(|(at, &accent)| error(at, accent).powi(2)).sum::<f64>()
    };
    let mean = accents.iter().sum::<f64>() / accents.len().max(1) as f64;
    let all = squares(&|_, accent| accent - mean);
    let within = squares(&|at, accent| accent - means[at % metre]);
    let (count, places) = (accents.len() as f64, metre as f64);
    if all <= 0.0 || count <= 2.0 * places {
        return 0.0;
    }
    1.0 - within / all * (count - 1.0) / (count - places)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(accents: &[f32], count: usize) -> (usize, Vec<usize>) {
        let mut beats: Vec<Beat> =
            (0..count).map(|k| Beat { frame: 10 * k, number: k % 3 + 1 }).collect();
        let rises: Vec<f32> = (0..10 * count)
            .map(|frame| if frame % 10 == 1 { accents[frame / 10 % accents.len()] } else { 0.0 })
            .collect();
        let metre = number_by_accent(&mut beats, &rises);
        (metre, beats.iter().take(5).map(|beat| beat.number).collect())
    }

    #[test]
    fn accents_make_bars_and_without_any_there_are_four() {
        assert_eq!(numbers(&[1.0, 0.5, 0.5], 30), (3, vec![1, 2, 3, 1, 2]));
        assert_eq!(numbers(&[0.5, 1.0, 0.5], 30), (3, vec![3, 1, 2, 3, 1]));
        assert_eq!(numbers(&[1.0, 0.6, 0.8, 0.6], 30), (4, vec![1, 2, 3, 4, 1]));
        assert_eq!(numbers(&[0.6, 1.0], 30), (4, vec![4, 1, 2, 3, 4]));
        assert_eq!(numbers(&[1.0], 30), (4, vec![1, 2, 3, 4, 1]));
        assert_eq!(numbers(&[1.0, 0.5, 0.5], 5).0, 4);
    }

    #[test]
    fn bars_are_told_by_the_activations_of_first_beats() {
        let beats: Vec<Beat> = (0..12).map(|k| Beat { frame: k, number: k % 3 + 1 }).collect();
        let active = |first: f32| -> Vec<Activation> {
            let downbeat = |k: usize| if k.is_multiple_of(3) { first } else { 0.3 };
            (0..12).map(|k| Activation { beat: 0.5, downbeat: downbeat(k) }).collect()
        };
        assert!(are_told(&beats, &active(0.5)));
        assert!(!are_told(&beats, &active(0.33)));
        let click = Activation { beat: 0.1, downbeat: 0.85 };
        let mut clicks = vec![click; 12];
        clicks[0].downbeat = 1.0;
        clicks[3].downbeat = 1.0;
        assert!(!are_told(&beats, &clicks));
    }
}
