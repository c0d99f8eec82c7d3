//! Single runs and steps of the GPT against the golden vectors (ARCHITECTURE section 5). Sampling
//! itself is the engine's: here every window is given.

use bailando_model::{Gpt, KvCache, Logits, NextStep, Steps};
use bailando_testkit::arrays::{assert_close, floats, load};
use ndarray::{Array1, Array2, Axis};

use crate::{SAMPLINGS, Sampling, TOLERANCE, directory, golden, music};

/// Longest history while sampling.
const CONTEXT: usize = 28;

impl Sampling {
    /// Length of the window at step `k` (ARCHITECTURE section 3).
    fn window(&self, k: usize) -> usize {
        if k < CONTEXT {
            return k + 1;
        }
        let period = (CONTEXT - self.kept + 1) as i64;
        self.kept + (k as i64 - CONTEXT as i64 - 1).rem_euclid(period) as usize
    }
}

/// Runs codes `from..to` of a golden sampling.
fn run(gpt: &mut Gpt, codes: &[[u32; 2]], from: usize, to: usize) -> Logits {
    gpt.logits(Steps { codes: &codes[from..to], music: music(from..to).view() }).unwrap()
}

fn row(logits: &Array2<f32>, row: usize) -> Array2<f32> {
    logits.select(Axis(0), &[row])
}

fn last_row(logits: &Array2<f32>) -> Array2<f32> {
    row(logits, logits.nrows() - 1)
}

fn golden_row(name: &str) -> Array2<f32> {
    let row: Array1<f32> = load(&golden(name));
    row.insert_axis(Axis(0))
}

#[test]
fn logits_are_golden() {
    let mut gpt = directory().gpt(1).unwrap();
    for sampling in SAMPLINGS {
        let codes = sampling.codes();
        for k in [0, 10, 28, 40] {
            let from = k + 1 - sampling.window(k);
            let logits = run(&mut gpt, &codes, from, k + 1);
            for (half, found) in [("up", &logits.upper), ("down", &logits.lower)] {
                let name = format!("logits_{}_k{k}_{half}.npy", sampling.name);
                assert_close(&last_row(found), &golden_row(&name), TOLERANCE, &name);
            }
        }
    }
    let logits = run(&mut gpt, &SAMPLINGS[0].codes(), 0, 29);
    for (half, found) in [("up", &logits.upper), ("down", &logits.lower)] {
        let name = format!("block_logits_{half}.npy");
        assert_close(found, &floats(&golden(&name)), TOLERANCE, &name);
    }
}

#[test]
fn the_likeliest_codes_are_golden() {
    let mut gpt = directory().gpt(1).unwrap();
    for sampling in SAMPLINGS {
        let codes = sampling.codes();
        for k in 0..codes.len() - 1 {
            let from = k + 1 - sampling.window(k);
            let logits = run(&mut gpt, &codes, from, k + 1);
            let next = [&logits.upper, &logits.lower].map(|half| first_maximum(&last_row(half)));
            assert_eq!(next.map(|code| code as u32), codes[k + 1], "{} step {k}", sampling.name);
        }
    }
}

fn first_maximum(row: &Array2<f32>) -> usize {
    let best = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    row.iter().position(|&value| value == best).unwrap()
}

#[test]
fn the_future_is_hidden() {
    let mut gpt = directory().gpt(1).unwrap();
    let codes = SAMPLINGS[0].codes();
    let mut other = codes.clone();
    other[20] = other[20].map(|code| (code + 1) % 16);
    let [first, second] = [&codes, &other].map(|codes| run(&mut gpt, codes, 0, 28));
    let changed: Vec<usize> =
        (0..28).filter(|&row| first.upper.row(row) != second.upper.row(row)).collect();
    assert_eq!(changed, (20..28).collect::<Vec<_>>());
}

/// Steps through golden codes to the end of the context in some rows that all do the same after a
/// prefill; logits of the last row.
fn stepped(gpt: &mut Gpt, cache: &mut KvCache, prefilled: usize, rows: usize) -> Vec<Logits> {
    let codes = SAMPLINGS[1].codes();
    for row in 0..rows {
        cache.clear(row);
        if prefilled > 0 {
            let music = music(0..prefilled);
            let steps = Steps { codes: &codes[..prefilled], music: music.view() };
            gpt.prefill(cache, row, steps).unwrap();
        }
        assert_eq!(cache.steps(row), prefilled);
    }
    let music = music(0..CONTEXT);
    (prefilled..CONTEXT)
        .map(|step| {
            assert_eq!(cache.steps(rows - 1), step);
            let next = NextStep { codes: codes[step], music: music.row(step) };
            let Logits { upper, lower } = gpt.step(cache, &vec![next; rows]).unwrap();
            Logits { upper: last_row(&upper), lower: last_row(&lower) }
        })
        .collect()
}

#[test]
fn cached_steps_equal_the_whole_window() {
    let mut gpt = directory().gpt(1).unwrap();
    let mut cache = gpt.cache(4);
    let codes = SAMPLINGS[1].codes();
    let whole: Vec<Logits> = (0..CONTEXT).map(|step| run(&mut gpt, &codes, 0, step + 1)).collect();
    for (prefilled, rows) in [(0, 1), (1, 1), (7, 1), (7, 4), (15, 1)] {
        let stepped = stepped(&mut gpt, &mut cache, prefilled, rows);
        for (step, found) in (prefilled..).zip(&stepped) {
            let what = format!("step {step} of {rows} after a prefill of {prefilled}");
            assert_close(&found.upper, &last_row(&whole[step].upper), TOLERANCE, &what);
            assert_close(&found.lower, &last_row(&whole[step].lower), TOLERANCE, &what);
        }
    }
}
