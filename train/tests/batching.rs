//! Motions that share the model's steps come out as if each were alone.

use std::sync::{
    Arc, Barrier,
    atomic::{AtomicUsize, Ordering},
};

use crate::common::{TOLERANCE, assert_close, codes, fixture, floats, imported, rows};
use bailando::{
    engine::{
        Engine, EngineConfig, EngineError, GenerationOptions, GenerationOutput, GenerationRequest,
        Progress,
    },
    model::{Gpt, KvCache, Logits, NextStep, Steps, WeightStorage, WindowKind, code_pairs},
};
use ndarray::{Array2, Axis};
use tempfile::TempDir;

fn open(folder: &TempDir, batch: usize) -> Result<Engine, EngineError> {
    Engine::open(&EngineConfig {
        threads: 1,
        batch,
        queue: 16,
        ..EngineConfig::new(folder.path().join("model"))
    })
}

/// The golden rows over and over, from some row on.
fn music(first: usize, length: usize) -> Array2<f32> {
    let golden = floats(&fixture("music.npy"));
    let rows: Vec<usize> = (first..first + length).map(|row| row % golden.nrows()).collect();
    golden.select(Axis(0), &rows)
}

fn options(number: usize) -> GenerationOptions {
    GenerationOptions {
        seed: Some(number as u64),
        temperature: Some(1.0),
        window: Some(match number % 3 {
            0 => WindowKind::Sliding,
            _ => WindowKind::Hop,
        }),
        hop: Some(5 + number),
        guidance: Some(if number % 4 == 1 { 1.5 } else { 1.0 }),
        ..GenerationOptions::default()
    }
}

fn dance(
    engine: &Engine,
    number: usize,
    progress: Arc<dyn Progress>,
) -> Result<GenerationOutput, EngineError> {
    let length = match number {
        // More than one chunk of frames.
        4 => 230,
        _ => 40 + 9 * number,
    };
    let music = music(number * 7, length);
    let request = GenerationRequest::features(music, options(number));
    engine.generate(request.with_progress(progress))
}

/// Holds the model's thread at its first code until all requests are there.
struct Hold(Barrier, AtomicUsize);

impl Hold {
    fn new() -> Arc<Self> {
        Arc::new(Self(Barrier::new(2), AtomicUsize::new(0)))
    }
}

impl Progress for Hold {
    fn codes(&self, _done: usize, _total: usize) {
        if self.1.fetch_add(1, Ordering::SeqCst) == 0 {
            self.0.wait();
            self.0.wait();
        }
    }
}

#[test]
fn dances_side_by_side_are_those_that_each_gets_alone() {
    const DANCES: usize = 8;
    for weights in [WeightStorage::F32, WeightStorage::Int8] {
        let (folder, _) = imported(|options| options.description.weights = weights);
        let alone = open(&folder, 2).unwrap();
        let alone: Vec<GenerationOutput> =
            (0..DANCES).map(|number| dance(&alone, number, Arc::new(())).unwrap()).collect();
        // All at once; and more than there are rows, so that they take turns.
        for batch in [16, 3] {
            let together = open(&folder, batch).unwrap();
            let hold = Hold::new();
            let results = std::thread::scope(|scope| {
                let first = scope.spawn(|| dance(&together, 0, hold.clone()));
                hold.0.wait();
                let others: Vec<_> = (1..DANCES)
                    .map(|number| {
                        let together = &together;
                        scope.spawn(move || dance(together, number, Arc::new(())))
                    })
                    .collect();
                hold.0.wait();
                let all = std::iter::once(first).chain(others);
                let results = all.map(|dance| dance.join().unwrap().unwrap());
                results.collect::<Vec<_>>()
            });
            for (number, (found, wanted)) in results.iter().zip(&alone).enumerate() {
                assert_eq!(found.codes, wanted.codes, "{weights:?} {batch} {number}");
                let [found, wanted] = [found, wanted].map(|one| one.clone().into_decoded());
                assert_eq!(found, wanted, "{weights:?} {batch} {number}");
            }
        }
    }
}

#[test]
fn a_long_song_does_not_block_a_short_one() {
    struct Counting(Arc<Hold>, AtomicUsize);
    impl Progress for Counting {
        fn codes(&self, done: usize, total: usize) {
            self.1.store(done, Ordering::SeqCst);
            self.0.codes(done, total);
        }
    }
    let (folder, _) = imported(|_| {});
    // A single row: they cannot go side by side.
    let engine = open(&folder, 1).unwrap();
    let options = GenerationOptions { window: Some(WindowKind::Hop), ..options(2) };
    let (short, long) = (60, 6_000);
    let counting = Arc::new(Counting(Hold::new(), AtomicUsize::new(0)));
    std::thread::scope(|scope| {
        let running = scope.spawn(|| {
            let request = GenerationRequest::features(music(0, long), options.clone());
            engine.generate(request.with_progress(counting.clone()))
        });
        counting.0.0.wait();
        let waiting = scope.spawn(|| {
            engine.generate(GenerationRequest::features(music(0, short), options.clone()))
        });
        // It must be in the queue before the model goes on: it has no way to say so.
        std::thread::sleep(std::time::Duration::from_millis(200));
        counting.0.0.wait();
        assert_eq!(waiting.join().unwrap().unwrap().codes.upper.len(), short);
        let done = counting.1.load(Ordering::SeqCst);
        assert!(done < long / 2, "{done} codes of the long song were first");
        assert_eq!(running.join().unwrap().unwrap().codes.upper.len(), long);
    });
}

#[test]
fn what_does_not_fit_into_the_batch_is_refused() {
    let (folder, _) = imported(|_| {});
    let engine = open(&folder, 3).unwrap();
    let refused = |candidates: usize, guidance: f32| {
        let options = GenerationOptions {
            candidates: Some(candidates),
            guidance: Some(guidance),
            temperature: Some(1.0),
            ..GenerationOptions::default()
        };
        engine.check(&options).err()
    };
    assert!(refused(3, 1.0).is_none());
    for (candidates, guidance) in [(4, 1.0), (2, 2.0)] {
        let error = refused(candidates, guidance).unwrap();
        let EngineError::Option { name, .. } = error else {
            panic!("{error}");
        };
        assert_eq!(name, "candidates");
    }
    // Of a model's own candidates as many are tried as fit.
    let (folder, _) = imported(|options| options.description.candidates = 3);
    assert!(open(&folder, 2).is_ok());
}

fn golden() -> (Vec<u32>, Vec<u32>) {
    let codes = ["up", "down"].map(|half| codes(&fixture(&format!("codes_slide_{half}.npy"))));
    let [upper, lower] = codes;
    (upper, lower)
}

/// The first steps of the golden codes, one by one, in the last of some rows that all do the same.
fn stepped(gpt: &mut Gpt, cache: &mut KvCache, prefilled: usize, dances: usize) -> Vec<Logits> {
    let ((upper, lower), music) = (golden(), floats(&fixture("music.npy")));
    let codes = code_pairs(&upper, &lower).unwrap();
    for row in 0..dances {
        cache.clear(row);
        if prefilled > 0 {
            let steps = Steps { codes: &codes[..prefilled], music: rows(&music, 1..prefilled + 1) };
            gpt.prefill(cache, row, steps).unwrap();
        }
        assert_eq!(cache.steps(row), prefilled);
    }
    (prefilled..20)
        .map(|step| {
            let next = NextStep { codes: codes[step], music: music.row(step + 1) };
            let Logits { upper, lower } = gpt.step(cache, &vec![next; dances]).unwrap();
            let last = |half: Array2<f32>| half.select(Axis(0), &[dances - 1]);
            Logits { upper: last(upper), lower: last(lower) }
        })
        .collect()
}

#[test]
fn steps_from_memory_are_those_of_a_whole_run() {
    let (_folder, directory) = imported(|_| {});
    let mut gpt = directory.gpt(1).unwrap();
    let mut cache = gpt.cache(4);
    let ((upper, lower), music) = (golden(), floats(&fixture("music.npy")));
    for (primed, dances) in [(0, 1), (7, 1), (7, 4)] {
        let stepped = stepped(&mut gpt, &mut cache, primed, dances);
        for (step, found) in (primed..).zip(&stepped) {
            let steps = Steps {
                codes: &code_pairs(&upper[..=step], &lower[..=step]).unwrap(),
                music: rows(&music, 1..step + 2),
            };
            let whole = gpt.logits(steps).unwrap();
            let last = |half: &Array2<f32>| half.select(Axis(0), &[step]);
            let what = format!("step {step} of {dances} after {primed}");
            assert_close(&found.upper, &last(&whole.upper), TOLERANCE, &what);
            assert_close(&found.lower, &last(&whole.lower), TOLERANCE, &what);
        }
    }
}

#[test]
fn eight_bit_matrices_stay_close_and_smaller() {
    let (_exact_folder, exact) = imported(|_| {});
    let (_folder, small) = imported(|options| options.description.weights = WeightStorage::Int8);
    let size =
        |directory: &bailando::model::ModelDirectory| directory.manifest().files["gpt.onnx"].bytes;
    assert!(size(&small) < size(&exact) / 2);
    let logits = |directory: &bailando::model::ModelDirectory| {
        let mut gpt = directory.gpt(1).unwrap();
        let mut cache = gpt.cache(1);
        stepped(&mut gpt, &mut cache, 4, 1)
    };
    for (exact, small) in logits(&exact).iter().zip(&logits(&small)) {
        for (exact, small) in [(&exact.upper, &small.upper), (&exact.lower, &small.lower)] {
            let error = (exact - small).mapv(|x| x * x).sum().sqrt();
            let size = exact.mapv(|x| x * x).sum().sqrt();
            // Logits of a toy with 48 channels, where little cancels out.
            assert!(error > 0.0 && error < 0.15 * size, "{error} of {size}");
        }
    }
}
