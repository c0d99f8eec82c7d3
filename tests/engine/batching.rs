//! Motions that share the model's steps come out as if each were alone.

use std::{
    path::Path,
    sync::{
        Arc, Barrier,
        atomic::{AtomicUsize, Ordering},
    },
};

use bailando::{
    engine::{
        Engine, EngineConfig, EngineError, GenerationOptions, GenerationOutput, GenerationRequest,
        Progress,
    },
    model::WindowKind,
};
use bailando_testkit::{
    arrays::floats,
    model::{changed, tiny, tiny_dancer},
};
use ndarray::{Array2, Axis, concatenate};

use super::golden;

fn open(model: &Path, batch: usize) -> Result<Engine, EngineError> {
    Engine::open(&EngineConfig { threads: 1, batch, queue: 16, ..EngineConfig::new(model) })
}

/// The golden rows over and over, from some row on, and columns of counts where the model has them.
fn music(engine: &Engine, first: usize, length: usize) -> Array2<f32> {
    let golden = floats(&golden("music.npy"));
    let rows: Vec<usize> = (first..first + length).map(|row| row % golden.nrows()).collect();
    let counts = engine.manifest().features.columns - golden.ncols();
    let counts = Array2::from_shape_fn((length, counts), |(row, column)| {
        ((first + row) as f32 / (column + 1) as f32).sin()
    });
    concatenate(Axis(1), &[golden.select(Axis(0), &rows).view(), counts.view()]).unwrap()
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
    let music = music(engine, number * 7, length);
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
    // Weights in 32 and in 8 bits.
    for model in [tiny(), tiny_dancer()] {
        let alone = open(&model, 2).unwrap();
        let alone: Vec<GenerationOutput> =
            (0..DANCES).map(|number| dance(&alone, number, Arc::new(())).unwrap()).collect();
        // All at once; and more than there are rows, so that they take turns.
        for batch in [16, 3] {
            let together = open(&model, batch).unwrap();
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
                assert_eq!(found.codes, wanted.codes, "{model:?} {batch} {number}");
                let [found, wanted] = [found, wanted].map(|one| one.clone().into_decoded());
                assert_eq!(found, wanted, "{model:?} {batch} {number}");
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
    // A single row: they cannot go side by side.
    let engine = open(&tiny(), 1).unwrap();
    let options = GenerationOptions { window: Some(WindowKind::Hop), ..options(2) };
    let (short, long) = (60, 6_000);
    let counting = Arc::new(Counting(Hold::new(), AtomicUsize::new(0)));
    std::thread::scope(|scope| {
        let running = scope.spawn(|| {
            let request = GenerationRequest::features(music(&engine, 0, long), options.clone());
            engine.generate(request.with_progress(counting.clone()))
        });
        counting.0.0.wait();
        let waiting = scope.spawn(|| {
            engine.generate(GenerationRequest::features(music(&engine, 0, short), options.clone()))
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
    let engine = open(&tiny(), 3).unwrap();
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
    let folder = changed(&tiny(), |manifest| manifest["sampling"]["candidates"] = 3.into());
    assert!(open(folder.path(), 2).is_ok());
}
