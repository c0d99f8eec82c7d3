//! The most likely beats of a bar of known length: a hidden Markov model (BEATS, HMM).
//!
//! A state is (beat of the bar, interval in frames, place within it). Inside of a beat there is one
//! way on, so that only entries into beats are stored: a beat's observations are differences of
//! running sums.

/// Steepness of the penalty for a change of the interval.
const LAMBDA: f64 = 100.0;
/// A beat's interval has so many parts, the first of which is where the beat sounds.
const PARTS: usize = 16;
const FLOOR: f64 = -1_000.0;
/// Transitions that are not more likely do not occur.
const LEAST: f64 = 2.2e-16;

/// Activations of a frame: of a beat that is not the bar's first, and of the first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Activation {
    pub(super) beat: f32,
    pub(super) downbeat: f32,
}

impl Activation {
    /// That of a beat, whatever its number.
    pub(super) fn any(self) -> f32 {
        self.beat.max(self.downbeat)
    }
}

/// A beat: its frame, and its number in the bar, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Beat {
    pub(super) frame: usize,
    pub(super) number: usize,
}

/// The most likely beats, and the logarithm of their probability.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pub(super) log_probability: f64,
    pub(super) beats: Vec<Beat>,
}

/// A model of bars of one length.
#[derive(Debug)]
pub(super) struct BarModel {
    metre: usize,
    /// Frames of a beat, ascending.
    intervals: Vec<usize>,
    /// Logarithms of the probability of each interval after each other, `[before][after]`.
    transitions: Vec<Vec<f64>>,
}

/// Running sums of the logarithms of observations, over the frames before each.
struct Sums {
    beat: Vec<f64>,
    downbeat: Vec<f64>,
    rest: Vec<f64>,
}

impl Sums {
    fn new(activations: &[Activation]) -> Self {
        let log = |probability: f64| probability.ln().max(FLOOR);
        let running = |of: &dyn Fn(&Activation) -> f64| {
            let mut sum = 0.0;
            let sums = activations.iter().map(|activation| {
                // f64::max gives the floor for the logarithm of a negative number as well.
                sum += log(of(activation));
                sum
            });
            std::iter::once(0.0).chain(sums).collect()
        };
        Self {
            beat: running(&|a| f64::from(a.beat)),
            downbeat: running(&|a| f64::from(a.downbeat)),
            rest: running(&|a| {
                (1.0 - f64::from(a.beat) - f64::from(a.downbeat)) / (PARTS - 1) as f64
            }),
        }
    }

    /// Of the frames from `start` to `end` of a beat, of which those before `middle` are places of
    /// the beat itself. Frames before the first have none.
    fn of(&self, is_first: bool, start: isize, middle: isize, end: isize) -> f64 {
        let beat = if is_first { &self.downbeat } else { &self.beat };
        let at = |sums: &[f64], frame: isize| sums[frame.max(0) as usize];
        let middle = middle.min(end);
        at(beat, middle) - at(beat, start) + at(&self.rest, end) - at(&self.rest, middle)
    }
}

/// A beat on a path: of the bar, its interval's index, the frame it begins in; before 0 where the
/// signal begins within it.
#[derive(Clone, Copy)]
struct Entry {
    beat: usize,
    interval: usize,
    start: isize,
}

impl BarModel {
    /// A model of bars of `metre` beats, with intervals from `shortest` to `longest` frames.
    pub(super) fn new(metre: usize, shortest: usize, longest: usize) -> Self {
        let intervals: Vec<usize> = (shortest..=longest).collect();
        let row = |&from: &usize| {
            let ratio = |&to: &usize| to as f64 / from as f64;
            let weights = intervals.iter().map(|to| (-LAMBDA * (ratio(to) - 1.0).abs()).exp());
            let weights: Vec<f64> = weights.map(|w| if w <= LEAST { 0.0 } else { w }).collect();
            let sum: f64 = weights.iter().sum();
            weights.iter().map(|weight| (weight / sum).ln()).collect()
        };
        Self { metre, transitions: intervals.iter().map(row).collect(), intervals }
    }

    pub(super) fn metre(&self) -> usize {
        self.metre
    }

    /// Finds the most likely path (Viterbi).
    pub(super) fn best_path(&self, activations: &[Activation]) -> Path {
        let sums = Sums::new(activations);
        let (entries, origins) = self.enter(&sums, activations.len());
        let (log_probability, last) = self.best_end(&sums, &entries, activations.len() as isize);
        let mut beats = Vec::new();
        let mut next = Some(last);
        while let Some(entry) = next {
            beats.extend(self.sounding(entry, activations));
            next = self.before(entry, &origins);
        }
        beats.reverse();
        Path { log_probability, beats }
    }

    /// Frames of an interval in which the beat sounds.
    fn places(&self, interval: usize) -> isize {
        self.intervals[interval].div_ceil(PARTS) as isize
    }

    /// The score of being in a beat at `end`.
    fn score(&self, sums: &Sums, entries: &Entries, entry: Entry, end: isize) -> f64 {
        let Entry { beat, interval, start } = entry;
        let middle = start + self.places(interval);
        entries.get(entry) + sums.of(beat == 0, start, middle, end)
    }

    /// The scores of the entries into all beats, and the interval before each.
    fn enter(&self, sums: &Sums, frames: usize) -> (Entries, Vec<u8>) {
        let count = self.intervals.len();
        let longest = self.intervals.last().copied().unwrap_or(1);
        let states = self.metre * self.intervals.iter().sum::<usize>();
        let mut entries = Entries {
            metre: self.metre,
            count,
            kept: longest + 1,
            outside: -(states as f64).ln(),
            scores: vec![f64::NEG_INFINITY; (longest + 1) * self.metre * count],
        };
        let mut origins = Vec::with_capacity(frames * self.metre * count);
        let mut best = vec![0.0; count];
        for frame in 0..frames as isize {
            for beat in 0..self.metre {
                let before = (beat + self.metre - 1) % self.metre;
                best.fill(f64::NEG_INFINITY);
                let first = origins.len();
                origins.resize(first + count, 0_u8);
                for (interval, row) in self.transitions.iter().enumerate() {
                    let start = frame - self.intervals[interval] as isize;
                    let entry = Entry { beat: before, interval, start };
                    let left = self.score(sums, &entries, entry, frame);
                    let ways = row.iter().zip(&mut best).zip(&mut origins[first..]);
                    for ((change, best), origin) in ways {
                        // Of equal ones the shortest interval stays.
                        if left + change > *best {
                            (*best, *origin) = (left + change, interval as u8);
                        }
                    }
                }
                entries.row(beat, frame).copy_from_slice(&best);
            }
        }
        (entries, origins)
    }

    /// The best state in the last frame.
    fn best_end(&self, sums: &Sums, entries: &Entries, frames: isize) -> (f64, Entry) {
        let mut best = (f64::NEG_INFINITY, Entry { beat: 0, interval: 0, start: 0 });
        for beat in 0..self.metre {
            for (interval, &length) in self.intervals.iter().enumerate() {
                for place in 1..=length as isize {
                    let entry = Entry { beat, interval, start: frames - place };
                    let score = self.score(sums, entries, entry, frames);
                    if score > best.0 {
                        best = (score, entry);
                    }
                }
            }
        }
        best
    }

    /// The beat before another, unless the signal begins there.
    fn before(&self, entry: Entry, origins: &[u8]) -> Option<Entry> {
        let start = usize::try_from(entry.start).ok().filter(|&start| start > 0)?;
        let place = (start * self.metre + entry.beat) * self.intervals.len() + entry.interval;
        let interval = usize::from(origins[place]);
        let beat = (entry.beat + self.metre - 1) % self.metre;
        Some(Entry { beat, interval, start: entry.start - self.intervals[interval] as isize })
    }

    /// The frame in which a beat sounds: that of the highest activation among its places.
    fn sounding(&self, entry: Entry, activations: &[Activation]) -> Option<Beat> {
        let end = entry.start + self.places(entry.interval);
        let frames = entry.start.max(0) as usize..(end.max(0) as usize).min(activations.len());
        let louder = |best: usize, next: usize| {
            let is_louder = activations[next].any() > activations[best].any();
            if is_louder { next } else { best }
        };
        let frame = frames.reduce(louder)?;
        Some(Beat { frame, number: entry.beat + 1 })
    }
}

/// Scores of the entries of the last frames.
struct Entries {
    metre: usize,
    count: usize,
    /// Frames that are kept.
    kept: usize,
    /// Score of an entry before the first frame: every state is as likely.
    outside: f64,
    scores: Vec<f64>,
}

impl Entries {
    fn place(&self, beat: usize, frame: usize) -> usize {
        (frame % self.kept * self.metre + beat) * self.count
    }

    fn get(&self, entry: Entry) -> f64 {
        match usize::try_from(entry.start) {
            Ok(start) => self.scores[self.place(entry.beat, start) + entry.interval],
            Err(_) => self.outside,
        }
    }

    fn row(&mut self, beat: usize, frame: isize) -> &mut [f64] {
        let place = self.place(beat, frame as usize);
        &mut self.scores[place..place + self.count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The path of the highest probability by trying all states in every frame.
    fn by_definition(model: &BarModel, activations: &[Activation]) -> f64 {
        let mut states = Vec::new();
        for beat in 0..model.metre {
            for (interval, &length) in model.intervals.iter().enumerate() {
                states.extend((0..length).map(|place| (beat, interval, place)));
            }
        }
        let mut scores = vec![-(states.len() as f64).ln(); states.len()];
        for activation in activations {
            let next = states.iter().map(|&(beat, interval, place)| {
                let from = states.iter().zip(&scores).filter_map(|(&(b, i, p), score)| {
                    let last = p + 1 == model.intervals[i];
                    let change = match place {
                        0 if last && (b + 1) % model.metre == beat => {
                            model.transitions[i][interval]
                        }
                        0 => return None,
                        _ if (b, i, p + 1) == (beat, interval, place) => 0.0,
                        _ => return None,
                    };
                    Some(score + change)
                });
                let from = from.fold(f64::NEG_INFINITY, f64::max);
                let sounds = place * PARTS < model.intervals[interval];
                let (beat_on, first_on) = (f64::from(activation.beat), activation.downbeat.into());
                let seen: f64 = match (sounds, beat) {
                    (true, 0) => first_on,
                    (true, _) => beat_on,
                    (false, _) => (1.0 - beat_on - first_on) / 15.0,
                };
                from + seen.ln().max(FLOOR)
            });
            scores = next.collect();
        }
        scores.into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    fn pulses(frames: usize, period: f64, metre: usize) -> Vec<Activation> {
        let mut activations = vec![Activation { beat: 0.02, downbeat: 0.01 }; frames];
        for beat in 0.. {
            let frame = (3.0 + beat as f64 * period).round() as usize;
            let Some(activation) = activations.get_mut(frame) else { break };
            *activation = match beat % metre {
                1 => Activation { beat: 0.1, downbeat: 0.8 },
                _ => Activation { beat: 0.8, downbeat: 0.1 },
            };
        }
        activations
    }

    #[test]
    fn the_best_path_is_that_of_all_states() {
        let model = BarModel::new(3, 5, 9);
        for period in [5.0, 6.5, 8.3] {
            let mut activations = pulses(45, period, 3);
            activations[11] = Activation { beat: 0.6, downbeat: 0.5 };
            let found = model.best_path(&activations);
            let expected = by_definition(&model, &activations);
            assert!((found.log_probability - expected).abs() < 1e-9, "{period}: {found:?}");
        }
    }

    #[test]
    fn beats_lie_on_pulses_and_carry_their_numbers() {
        for metre in [3, 4] {
            let activations = pulses(600, 23.7, metre);
            let path = BarModel::new(metre, 14, 55).best_path(&activations);
            let expected = (0..).map(|beat| {
                let frame = (3.0 + beat as f64 * 23.7).round() as usize;
                Beat { frame, number: (beat + metre - 1) % metre + 1 }
            });
            let expected: Vec<Beat> = expected.take_while(|beat| beat.frame < 600).collect();
            assert_eq!(path.beats, expected);
        }
        // Bars of the other length are less likely.
        let activations = pulses(600, 23.7, 3);
        let likely = |metre| BarModel::new(metre, 14, 55).best_path(&activations).log_probability;
        assert!(likely(3) > likely(4) + 10.0);
    }

    #[test]
    fn short_signals_and_impossible_observations_do_not_panic() {
        let model = BarModel::new(4, 14, 55);
        for activation in [(0.0, 0.0), (1.0, 0.0), (0.7, 0.7)] {
            let activation = Activation { beat: activation.0, downbeat: activation.1 };
            for frames in [1, 2, 13, 56, 130] {
                let path = model.best_path(&vec![activation; frames]);
                assert!(path.log_probability.is_finite());
                assert!(path.beats.iter().all(|beat| beat.frame < frames));
            }
        }
    }
}
