use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::Array2;
use tempfile::TempDir;

use super::*;
use crate::{
    audio::AudioLimits,
    engine::{
        Generation, GenerationOptions, GenerationOutput, Progress,
        conditioning::Conditioning,
        decoding::{self, Prologue},
        effort::DecodeEffort,
        fake::{FakeDecoder, FakeModel, Script, directory},
        form::Form,
        frontend::AudioFrontend,
        prepare::{AcceptedRequest, Preparer},
        queue::Queue,
    },
    features::COLUMNS,
    formats::{Codes, Continuation},
    model::WindowKind,
};

/// A scheduler over fakes.
struct Harness {
    scheduler: Scheduler,
    script: Arc<Mutex<Script>>,
    observer: Arc<Failures>,
    preparer: Preparer,
    _folder: TempDir,
}

#[derive(Debug, Default)]
struct Failures(AtomicUsize);

impl Observer for Failures {
    fn step_failed(&self) {
        self.0.fetch_add(1, Ordering::SeqCst);
    }
}

/// A request of a test: its options, and the length and first value of its music.
struct Asked {
    options: GenerationOptions,
    codes: usize,
    value: f32,
    beats: Vec<usize>,
    form: Form,
}

fn asked(seed: u64, codes: usize) -> Asked {
    Asked {
        options: GenerationOptions { seed: Some(seed), ..GenerationOptions::default() },
        codes,
        value: seed as f32,
        beats: Vec::new(),
        form: Form::default(),
    }
}

/// One that takes so many rows.
fn wide(seed: u64, codes: usize, rows: usize) -> Asked {
    let mut asked = asked(seed, codes);
    asked.options.candidates = Some(rows);
    asked.beats = (0..codes).map(|code| 8 * code + 3).collect();
    asked
}

impl Harness {
    fn new(rows: usize) -> Self {
        let (folder, directory) = directory();
        let model = FakeModel::new(rows);
        let script = Arc::clone(&model.script);
        let decoder = SharedDecoder::new(FakeDecoder {
            columns: directory.manifest().decoded_columns(),
            last: -1.0,
        });
        let decoding = decoding::start(decoder.clone(), 64).unwrap();
        let observer = Arc::new(Failures::default());
        let features = directory.manifest().features.clone();
        Self {
            scheduler: Scheduler::new(
                Box::new(model),
                decoder,
                Arc::clone(&directory),
                decoding.clone(),
                Arc::clone(&observer) as _,
            ),
            script,
            observer,
            preparer: Preparer {
                classifier: None,
                directory,
                frontend: AudioFrontend::new(
                    features,
                    AudioLimits::default(),
                    DecodeEffort::default(),
                ),
                rows,
                scheduled: Arc::new(Queue::new(1)),
                decoding,
            },
            _folder: folder,
        }
    }

    fn add(&mut self, asked: Asked) -> Generation {
        self.add_with(asked, Arc::new(()))
    }

    fn add_with(&mut self, asked: Asked, progress: Arc<dyn Progress>) -> Generation {
        let (completion, generation) = Completion::new();
        let seed = asked.options.seed.unwrap();
        let directory = Arc::clone(&self.preparer.directory);
        let conditioning = Conditioning {
            features: Array2::from_shape_fn((asked.codes, COLUMNS), |(row, column)| match column {
                0 => asked.value,
                _ => (row * 31 + column) as f32,
            }),
            beats: asked.beats,
            form: asked.form,
            music: None,
            seconds: None,
            warnings: Vec::new(),
        };
        let request = AcceptedRequest {
            prologue: Prologue::new(directory, &asked.options, seed),
            options: asked.options,
            progress,
            stream: None,
            longest: None,
            completion,
            submitted: Instant::now(),
            owner: 0,
        };
        let scheduled = self.preparer.schedule_conditioned(conditioning, request);
        scheduled.unwrap();
        let request = self.preparer.scheduled.try_pop().unwrap();
        self.scheduler.add(request);
        generation
    }

    fn steps(&mut self, count: usize) {
        (0..count).for_each(|_| self.scheduler.step());
    }

    fn finish(&mut self) {
        while !self.scheduler.is_idle() {
            self.scheduler.step();
        }
    }

    fn alone(asked: Asked) -> GenerationOutput {
        let mut harness = Self::new(16);
        let generation = harness.add(asked);
        harness.finish();
        generation.wait().unwrap()
    }

    /// Rows of the running requests.
    fn running(&self) -> Vec<usize> {
        let running = self.scheduler.running.iter();
        running.map(|request| request.sequence.rows()).collect()
    }
}

/// Requests of many kinds: windows, guidance, candidates, regenerated segments, lengths.
fn many() -> impl Iterator<Item = Asked> {
    (0..8).map(|number| {
        let mut asked = match number {
            3 => wide(number, 60, 3),
            number => asked(number, 40 + 9 * number as usize),
        };
        asked.options.window = Some(match number % 3 {
            0 => WindowKind::Sliding,
            _ => WindowKind::Hop,
        });
        asked.options.hop = Some(5 + number as usize);
        asked.options.guidance = (number == 1).then_some(1.5);
        asked.options.redo = (number == 5).then_some(true);
        asked
    })
}

#[test]
fn sequences_side_by_side_are_those_that_each_gets_alone() {
    let alone: Vec<_> = many().map(Harness::alone).collect();
    for rows in [16, 5, 3] {
        let mut together = Harness::new(rows);
        let generations: Vec<_> = many()
            .map(|asked| {
                together.steps(3);
                together.add(asked)
            })
            .collect();
        together.finish();
        for (generation, alone) in generations.into_iter().zip(&alone) {
            let found = generation.wait().unwrap();
            assert_eq!(found.codes, alone.codes, "{rows} rows, seed {}", found.seed);
            assert_eq!(found.clone().into_decoded(), alone.clone().into_decoded());
        }
        let steps = &together.script.lock().steps;
        assert!(steps.iter().all(|&step| step <= rows));
        assert!(steps.iter().any(|&step| step + 1 >= rows.min(6)), "{steps:?}");
    }
}

#[test]
fn a_seed_decides_and_a_continuation_begins_with_its_prompt() {
    let first = Harness::alone(asked(1, 30));
    assert_eq!(first.codes, Harness::alone(asked(1, 30)).codes);
    assert_ne!(first.codes, Harness::alone(asked(2, 30)).codes);
    assert_eq!(first.codes.upper.len(), 30);
    let before = Codes { upper: vec![3, 4, 5], lower: vec![6, 7, 8] };
    let mut next = asked(1, 30);
    let mut tail = Continuation::new("00", before, [1.0, 2.0], 0.5);
    next.options.continue_from = Some(tail.clone());
    let next = Harness::alone(next);
    assert_eq!(next.codes.upper.len(), 30);
    assert_ne!(next.codes, first.codes);
    let (codes, whole) = (next.codes.clone(), next.into_decoded());
    assert_eq!(whole.nrows(), 8 * 30);
    // A motion that ended inside its last code leaves the rest of that code to the next one.
    tail.shown = 3;
    let mut inside = asked(1, 30);
    inside.options.continue_from = Some(tail);
    let inside = Harness::alone(inside);
    assert_eq!(inside.codes, codes);
    assert_eq!(inside.into_decoded().nrows(), 5 + 8 * 30);
}

#[test]
fn a_dropped_request_takes_no_further_step() {
    let mut harness = Harness::new(2);
    let (kept, dropped) = (harness.add(asked(1, 40)), harness.add(asked(2, 40)));
    let waiting = harness.add(asked(3, 40));
    harness.steps(5);
    assert_eq!(harness.script.lock().steps.last(), Some(&2));
    drop((dropped, waiting));
    harness.steps(1);
    assert_eq!(harness.script.lock().steps.last(), Some(&1));
    harness.finish();
    // The rows of the one that stays have moved up: its codes say whether they were right.
    assert_eq!(kept.wait().unwrap().codes, Harness::alone(asked(1, 40)).codes);
    assert_eq!(harness.script.lock().steps.len(), 39);
}

/// A long sequence gives its rows up at the end of a segment, and continues later.
#[test]
fn a_long_sequence_does_not_block_a_short_one() {
    let mut harness = Harness::new(1);
    let long = harness.add(asked(1, 400));
    harness.steps(5);
    let short = harness.add(asked(2, 60));
    harness.steps(200);
    assert_eq!(short.wait().unwrap().codes, Harness::alone(asked(2, 60)).codes);
    assert!(!harness.scheduler.is_idle());
    harness.finish();
    assert_eq!(long.wait().unwrap().codes, Harness::alone(asked(1, 400)).codes);
}

/// The owner with less of the model's time, rows counted, goes first, and two requests of one
/// owner share the time that one request of another owner has.
#[test]
fn owners_share_the_time_of_the_model() {
    let mut harness = Harness::new(4);
    let _wide = harness.add(wide(1, 4000, 4));
    harness.scheduler.step();
    let _other = harness.add(wide(2, 4000, 4));
    harness.scheduler.waiting[0].owner = 1;
    let _third = harness.add(wide(3, 4000, 4));
    harness.scheduler.waiting[1].owner = 1;
    for request in &harness.scheduler.waiting {
        assert_eq!(request.spent, harness.scheduler.running[0].spent, "the least of those present");
    }
    let before = harness.scheduler.least_spent();
    let mut had = [Duration::ZERO; 2];
    for _ in 0..3_000 {
        let running = |harness: &Harness| {
            let request = harness.scheduler.running.first();
            request.map(|request| (request.owner, request.spent))
        };
        harness.scheduler.admit();
        let (owner, spent) = running(&harness).unwrap();
        harness.scheduler.charge(Duration::from_millis(1), 4);
        let (_, after) = running(&harness).unwrap();
        // What was counted, over the number of the owner's requests.
        had[owner as usize] += (after - spent) / [1, 2][owner as usize];
        harness.scheduler.running[0].fresh = false;
        harness.scheduler.running[0].sequence.chill();
    }
    assert!(harness.scheduler.least_spent() > before);
    let share = had[1].as_secs_f64() / (had[0] + had[1]).as_secs_f64();
    assert!((0.45..0.55).contains(&share), "{share}");
}

/// A wide request that is far ahead of a short one sits out until that has caught up or ended,
/// though there are rows for both: its rows would slow every step of the short one.
#[test]
fn a_request_far_ahead_rests_beside_a_short_one() {
    let mut harness = Harness::new(8);
    let wide_one = harness.add(wide(1, 400, 4));
    harness.steps(1);
    let short = harness.add(asked(2, 40));
    harness.scheduler.running[0].spent += MOST_AHEAD * 3;
    while harness.running() != [1] {
        harness.steps(1);
        assert!(harness.script.lock().steps.len() < 38, "the wide one rests from a segment on");
    }
    while harness.running() == [1] {
        harness.steps(1);
    }
    assert_eq!(short.wait().unwrap().codes, Harness::alone(asked(2, 40)).codes);
    harness.steps(1);
    assert_eq!(harness.running(), [4], "it goes on once nobody is behind it");
    harness.finish();
    assert_eq!(wide_one.wait().unwrap().codes, Harness::alone(wide(1, 400, 4)).codes);
}

/// Nothing is preempted for a request that would not fit all the same, and smaller ones that fit do
/// not wait behind it.
#[test]
fn smaller_requests_pass_a_wide_one_until_there_is_room_for_it() {
    let mut harness = Harness::new(4);
    // With a sliding window every step begins a segment: it could be preempted at any.
    let mut narrow = asked(1, 400);
    narrow.options.window = Some(WindowKind::Sliding);
    let narrow = harness.add(narrow);
    let other = harness.add(wide(2, 400, 2));
    harness.steps(2);
    let wide_one = harness.add(wide(3, 40, 4));
    let small = harness.add(asked(4, 10));
    harness.steps(1);
    assert_eq!(harness.running(), [1, 2, 1], "the small one fits, the wide one waits");
    harness.steps(10);
    assert_eq!(small.wait().unwrap().codes.upper.len(), 10);
    // A stream of small ones does not keep the wide one waiting for ever.
    let mut steps = 0;
    let mut small_ones = Vec::new();
    while harness.running() != [4] {
        small_ones.push(harness.add(asked(5, 10)));
        harness.steps(1);
        steps += 1;
        assert!(steps < 2 * MOST_PASSED_OVER + 30, "the wide one never starts");
    }
    harness.finish();
    for (generation, codes) in [(narrow, 400), (other, 400), (wide_one, 40)] {
        assert_eq!(generation.wait().unwrap().codes.upper.len(), codes);
    }
}

#[test]
fn a_failed_step_says_why_and_the_next_request_succeeds() {
    let mut harness = Harness::new(4);
    let both = [harness.add(asked(1, 40)), harness.add(asked(2, 40))];
    harness.steps(3);
    harness.script.lock().fail_step = true;
    harness.steps(1);
    for generation in both {
        let error = generation.wait().unwrap_err();
        assert!(matches!(error, EngineError::StepFailed { .. }), "{error:?}");
        assert!(error.to_string().ends_with("no step"), "{error}");
    }
    assert_eq!(harness.observer.0.load(Ordering::SeqCst), 1);
    let next = harness.add(asked(3, 40));
    harness.finish();
    assert_eq!(next.wait().unwrap().codes, Harness::alone(asked(3, 40)).codes);
}

/// Panics at its third code.
struct Panics;

impl Progress for Panics {
    fn codes(&self, done: usize, _total: usize) {
        assert!(done < 3, "a panic that the test wants");
    }
}

#[test]
fn a_request_fails_alone() {
    let mut harness = Harness::new(8);
    let before = harness.add(wide(1, 50, 2));
    let panics = harness.add_with(asked(2, 50), Arc::new(Panics));
    let no_prefill = harness.add(asked(3, 50));
    let no_numbers = harness.add(asked(4, 50));
    let after = harness.add(asked(5, 50));
    harness.steps(1);
    harness.script.lock().fail_prefill = Some(3.0);
    harness.script.lock().no_numbers = Some(4.0);
    harness.finish();
    let panicked = panics.wait().unwrap_err();
    assert!(matches!(panicked, EngineError::Panicked { .. }), "{panicked:?}");
    for failed in [no_prefill, no_numbers] {
        let failed = failed.wait().unwrap_err();
        assert!(matches!(failed, EngineError::Model(_)), "{failed:?}");
    }
    assert_eq!(before.wait().unwrap().codes, Harness::alone(wide(1, 50, 2)).codes);
    assert_eq!(after.wait().unwrap().codes, Harness::alone(asked(5, 50)).codes);
}

#[test]
fn begun_requests_are_bounded() {
    let mut harness = Harness::new(2);
    let mut generations = Vec::new();
    while harness.scheduler.has_place() {
        generations.push(harness.add(asked(generations.len() as u64, 40)));
    }
    assert_eq!(generations.len(), 2);
    harness.steps(1);
    assert!(harness.scheduler.has_place());
}

#[test]
fn what_returns_in_the_song_returns_in_the_dance() {
    for rows in [1, 3] {
        let codes = |form: Form| {
            let codes = Harness::alone(Asked { form, ..wide(5, 40, rows) }).codes;
            crate::model::code_pairs(&codes.upper, &codes.lower).unwrap()
        };
        let (formed, free) = (codes(Form::example()), codes(Form::default()));
        assert_eq!(formed[20..30], formed[..10]);
        assert_ne!(formed[30..], formed[10..20]);
        assert_ne!(free[20..30], free[..10]);
        // Of several candidates another may be the best.
        assert!(rows > 1 || formed[..15] == free[..15]);
    }
}
