//! Beats at the rate that sounds: the decoder has a range of tempi, and even ones cost it little.

use super::hmm::{Activation, Beat};

/// A beat is silent that is below this share of its neighbours, which are at least so active.
const SILENT_SHARE: f32 = 0.2;
const SOUNDING: f32 = 0.5;
/// Share of the mean below which a beat at either end is silent: the network starts at 0.2 or so.
const END_SHARE: f32 = 0.33;
/// Share of the activation on beats at which the middles between them are beats as well.
const EQUAL_SHARE: f32 = 0.8;
/// Frames on either side of a middle in which its beat is looked for.
const REACH: usize = 1;

/// Leaves out every other beat where it is silent, and adds the middles where they sound like
/// beats. Tells whether it did either; numbers in the bar are then those of other beats.
pub(super) fn correct(beats: &mut Vec<Beat>, activations: &[Activation]) -> bool {
    let before = beats.len();
    let strengths: Vec<f32> = beats.iter().map(|beat| activations[beat.frame].any()).collect();
    let mut places = 0..;
    beats.retain(|_| places.next().is_none_or(|place| !is_silent(&strengths, place)));
    let is_thinned = beats.len() < before;
    let middles = middles(beats, activations);
    let mean = |frames: &mut dyn Iterator<Item = usize>, count: usize| {
        frames.map(|frame| activations[frame].any()).sum::<f32>() / count.max(1) as f32
    };
    let on = mean(&mut beats.iter().map(|beat| beat.frame), beats.len());
    let between = mean(&mut middles.iter().copied(), middles.len());
    let is_doubled = !is_thinned && !middles.is_empty() && between >= EQUAL_SHARE * on;
    if is_doubled {
        beats.extend(middles.into_iter().map(|frame| Beat { frame, number: 0 }));
        beats.sort_by_key(|beat| beat.frame);
    }
    is_thinned || is_doubled
}

/// Leaves out silent beats before the first and after the last that sounds.
pub(super) fn trim(beats: &mut Vec<Beat>, activations: &[Activation]) {
    let active = |beat: &Beat| activations[beat.frame].any();
    let mean = beats.iter().map(active).sum::<f32>() / beats.len().max(1) as f32;
    let sounds = |beat: &Beat| active(beat) >= END_SHARE * mean;
    let first = beats.iter().position(sounds).unwrap_or(0);
    let end = beats.iter().rposition(sounds).map_or(0, |last| last + 1);
    beats.truncate(end);
    beats.drain(..first);
}

/// Whether the beats next to one sound, and it and the next but one, on either side, do not.
fn is_silent(strengths: &[f32], place: usize) -> bool {
    let mean = |places: &[Option<usize>]| {
        let strengths = places.iter().filter_map(|place| strengths.get((*place)?));
        let (sum, count) = strengths.fold((0.0, 0), |(sum, count), s| (sum + s, count + 1));
        (count == places.len()).then(|| sum / count as f32)
    };
    let at = |distance: isize| place.checked_add_signed(distance);
    // At a change of tempo one side alone is silent.
    let sides = [[at(-4), at(-2), at(0)], [at(0), at(2), at(4)]];
    let own = sides.iter().filter_map(|side| mean(side)).reduce(f32::min);
    let neighbours = [at(-1), at(1)].into_iter().flatten();
    let neighbours = neighbours.filter_map(|place| strengths.get(place)).copied();
    let Some((own, others)) = own.zip(neighbours.reduce(f32::min)) else { return false };
    others >= SOUNDING && own.max(strengths[place]) < SILENT_SHARE * others
}

/// The most active frame near each middle between two beats.
fn middles(beats: &[Beat], activations: &[Activation]) -> Vec<usize> {
    let middle = |pair: &[Beat]| {
        let [before, after] = pair else { return None };
        let middle = (before.frame + after.frame) / 2;
        let near = middle.saturating_sub(REACH)..=(middle + REACH).min(activations.len() - 1);
        near.max_by(|&a, &b| activations[a].any().total_cmp(&activations[b].any()))
    };
    beats.windows(2).filter_map(middle).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beats every `distance` frames, and activations every `sounding` frames.
    fn song(distance: usize, sounding: usize) -> (Vec<Beat>, Vec<Activation>) {
        let activation = |frame| Activation {
            beat: if frame % sounding == 0 { 0.9 } else { 0.03 },
            downbeat: 0.02,
        };
        let beats = (0..20).map(|k| Beat { frame: k * distance, number: k % 4 + 1 });
        (beats.collect(), (0..20 * distance).map(activation).collect())
    }

    fn frames(beats: &[Beat]) -> Vec<usize> {
        beats.iter().map(|beat| beat.frame).collect()
    }

    #[test]
    fn silent_beats_go_sounding_middles_come_and_others_stay() {
        let (mut beats, activations) = song(25, 50);
        assert!(correct(&mut beats, &activations));
        assert_eq!(frames(&beats), (0..10).map(|k| 50 * k).collect::<Vec<_>>());
        let (mut beats, activations) = song(24, 12);
        assert!(correct(&mut beats, &activations));
        assert_eq!(frames(&beats), (0..39).map(|k| 12 * k).collect::<Vec<_>>());
        let (mut beats, activations) = song(24, 24);
        let before = beats.clone();
        assert!(!correct(&mut beats, &activations));
        assert_eq!(beats, before);
        assert!(!correct(&mut Vec::new(), &[]));
    }

    #[test]
    fn silent_beats_at_the_ends_go() {
        let (mut beats, mut activations) = song(25, 25);
        for place in [0, 1, 5, 19] {
            activations[25 * place].beat = 0.1;
        }
        trim(&mut beats, &activations);
        assert_eq!(frames(&beats), (2..19).map(|k| 25 * k).collect::<Vec<_>>());
        activations.fill(Activation::default());
        trim(&mut Vec::new(), &activations);
    }

    #[test]
    fn silent_beats_go_in_their_part_of_the_song() {
        let (mut beats, mut activations) = song(25, 25);
        for beat in beats.iter().take(12).skip(1).step_by(2) {
            activations[beat.frame].beat = 0.03;
        }
        assert!(correct(&mut beats, &activations));
        let expected = (0..12).step_by(2).chain(12..20).map(|k| 25 * k);
        assert_eq!(frames(&beats), expected.collect::<Vec<_>>());
    }
}
