//! The motion GPT as a step graph with a key/value cache (paper Eq. 4-6, ARCHITECTURE section 3).

use std::{ops::Range, path::Path};

use ndarray::{Array2, Array4, ArrayView1, ArrayView2, Axis, Slice};
use ort::{
    memory::Allocator,
    value::{DynValue, Tensor},
};

use super::{
    Manifest, ModelError,
    cache::{KvCache, RowShape, STREAMS},
    error::one_line,
    session::{Graph, Inputs, SessionOptions, floats, integers, take, take_matrices, tensor},
};

const GRAPH: &str = "gpt.onnx";
/// Added to the scores of hidden tokens; exp of it is 0 in float32, and sums stay finite.
const HIDDEN: f32 = -1e9;

/// The motion GPT.
#[derive(Debug)]
pub struct Gpt {
    graph: Graph,
    names: CacheNames,
    heads: usize,
    head_size: usize,
    block: usize,
    context: usize,
    columns: usize,
}

/// Consecutive steps to run: each step is one music row and one code pair.
#[derive(Clone, Copy, Debug)]
pub struct Steps<'a> {
    /// Upper and lower codes `[steps]`.
    pub codes: &'a [[u32; 2]],
    /// The music rows beside them `[steps, columns]`.
    pub music: ArrayView2<'a, f32>,
}

/// The newest step of a sequence.
#[derive(Clone, Copy, Debug)]
pub struct NextStep<'a> {
    /// Upper and lower code.
    pub codes: [u32; 2],
    /// The music row beside them `[columns]`.
    pub music: ArrayView1<'a, f32>,
}

/// Unnormalised log-probabilities of the next codes, per step.
#[derive(Clone, Debug)]
pub struct Logits {
    /// `[steps, upper vocabulary]`.
    pub upper: Array2<f32>,
    /// `[steps, lower vocabulary]`.
    pub lower: Array2<f32>,
}

impl Logits {
    /// Checks that some rows hold finite numbers only.
    ///
    /// # Errors
    /// [`ModelError::Run`] if a value is NaN or infinite.
    pub fn check_rows(&self, rows: Range<usize>) -> Result<(), ModelError> {
        let finite = |logits: &Array2<f32>| {
            let rows = logits.slice_axis(Axis(0), Slice::from(rows.clone()));
            rows.iter().all(|logit| logit.is_finite())
        };
        match finite(&self.upper) && finite(&self.lower) {
            true => Ok(()),
            false => Err(ModelError::Run {
                graph: GRAPH,
                problem: "it predicts values that are not finite numbers".into(),
            }),
        }
    }
}

/// Names of the cache's inputs and outputs, keys and values per layer.
#[derive(Debug)]
struct CacheNames {
    past: Vec<[String; 2]>,
    present: Vec<[String; 2]>,
}

impl CacheNames {
    fn new(layers: usize) -> Self {
        let names = |when: &str| {
            (0..layers)
                .map(|layer| [format!("{when}_key.{layer}"), format!("{when}_value.{layer}")])
                .collect()
        };
        Self { past: names("past"), present: names("present") }
    }
}

/// What a run gives: logits, and keys and values of every layer.
struct Run {
    logits: Logits,
    present: Vec<[DynValue; 2]>,
}

impl Run {
    fn append_to(
        &self,
        cache: &mut KvCache,
        rows: Range<usize>,
        steps: usize,
    ) -> Result<(), ModelError> {
        let numbers = |value| -> Result<_, ModelError> {
            let tensor = DynValue::try_extract_tensor::<f32>(value);
            let (_, numbers) =
                tensor.map_err(|e| ModelError::Run { graph: GRAPH, problem: one_line(&e) })?;
            Ok(numbers)
        };
        let present = self.present.iter();
        let present = present.map(|[key, value]| Ok([numbers(key)?, numbers(value)?]));
        let present: Vec<_> = present.collect::<Result<_, ModelError>>()?;
        cache.append(GRAPH, rows, steps, &present)
    }
}

impl Gpt {
    /// Loads the graph at `path`, sized by `manifest`.
    ///
    /// # Errors
    /// [`ModelError::Graph`], [`ModelError::Mismatch`] or [`ModelError::Runtime`].
    pub(super) fn open(
        path: &Path,
        manifest: &Manifest,
        options: SessionOptions,
    ) -> Result<Self, ModelError> {
        // Steps have one shape per number of sequences, prefills one per number of steps.
        let graph = Graph::open(GRAPH, path, options, true)?;
        let spec = manifest.gpt;
        let names = CacheNames::new(spec.layers);
        let inputs = ["upper", "lower", "music", "positions", "attention_bias"];
        let inputs = inputs.into_iter().map(str::to_owned);
        let inputs: Vec<String> = inputs.chain(names.past.iter().flatten().cloned()).collect();
        graph.expect_inputs(path, &inputs)?;
        Ok(Self {
            graph,
            names,
            heads: spec.heads,
            head_size: spec.channels / spec.heads.max(1),
            block: spec.block,
            context: spec.context,
            columns: manifest.conditioning_columns(),
        })
    }

    /// Logits of consecutive steps, from position 0 on and without a cache.
    ///
    /// # Errors
    /// [`ModelError::Input`] when lengths do not fit, or [`ModelError::Run`].
    pub fn logits(&mut self, steps: Steps<'_>) -> Result<Logits, ModelError> {
        Ok(self.run_alone(steps)?.logits)
    }

    /// An empty cache for sequences side by side, `rows` at most.
    #[must_use]
    pub fn cache(&self, rows: usize) -> KvCache {
        let shape = RowShape {
            heads: self.heads,
            // The newest step of a whole window is not kept: the window moves next.
            steps: self.context.saturating_sub(1).max(1),
            head_size: self.head_size,
        };
        KvCache::new(rows, self.names.past.len(), shape)
    }

    /// Makes a row of `cache` hold `steps`, from position 0 on, and nothing else.
    ///
    /// # Errors
    /// As [`Gpt::logits`]; also for more steps than a row holds. The row is empty then.
    pub fn prefill(
        &mut self,
        cache: &mut KvCache,
        row: usize,
        steps: Steps<'_>,
    ) -> Result<(), ModelError> {
        cache.clear(row);
        let count = steps.codes.len();
        if count > cache.shape().steps {
            return Err(ModelError::Input {
                what: "GPT cache",
                expected: format!("at most {} steps in a row", cache.shape().steps),
                got: format!("{count} steps"),
            });
        }
        self.run_alone(steps)?.append_to(cache, row..row + 1, count)
    }

    /// Computes one more step of the sequences in the first rows of `cache`, which then hold it as
    /// well, and returns the logits that follow, a row each: the same as if each were alone.
    ///
    /// # Errors
    /// [`ModelError::Input`] when there are more sequences than rows, or music of another width;
    /// [`ModelError::Run`]. The cache is unchanged then.
    pub fn step(
        &mut self,
        cache: &mut KvCache,
        next: &[NextStep<'_>],
    ) -> Result<Logits, ModelError> {
        let count = next.len();
        let fits = next.iter().all(|step| step.music.len() == self.columns);
        if count == 0 || count > cache.rows() || !fits {
            return Err(ModelError::Input {
                what: "GPT steps",
                expected: format!("1 to {} beside music of {} columns", cache.rows(), self.columns),
                got: format!("{count}, or music of another width"),
            });
        }
        let music: Vec<f32> = next.iter().flat_map(|step| step.music).copied().collect();
        let music = tensor(GRAPH, Tensor::from_array(([count, 1, self.columns], music)))?;
        let positions = (0..count).map(|row| cache.steps(row) as i64);
        let half = |half: usize| {
            let codes = next.iter().map(|step| i64::from(step.codes[half]));
            integers(GRAPH, count, codes)
        };
        let mut inputs: Inputs<'_> = vec![
            ("upper".into(), half(0)?.into()),
            ("lower".into(), half(1)?.into()),
            ("music".into(), music.into()),
            ("positions".into(), integers(GRAPH, count, positions)?.into()),
            ("attention_bias".into(), floats(GRAPH, step_bias(cache, count).view())?.into()),
        ];
        let layers = cache.first(GRAPH, count)?;
        for (names, tensors) in self.names.past.iter().zip(layers) {
            let named = names.iter().cloned().zip(tensors.map(Into::into));
            inputs.extend(named);
        }
        let run = self.run(inputs, [count, 1])?;
        run.append_to(cache, 0..count, 1)?;
        Ok(run.logits)
    }

    /// Runs steps of one sequence with nothing before them.
    fn run_alone(&mut self, steps: Steps<'_>) -> Result<Run, ModelError> {
        let count = steps.codes.len();
        if count == 0 || steps.music.dim() != (count, self.columns) || count > self.block {
            return Err(ModelError::Input {
                what: "GPT steps",
                expected: format!(
                    "1 to {} code pairs, and as many rows of {} columns",
                    self.block, self.columns
                ),
                got: format!("{count} code pairs, {:?} music", steps.music.dim()),
            });
        }
        let half = |half: usize| {
            let codes = steps.codes.iter().map(|pair| i64::from(pair[half]));
            integers(GRAPH, 1, codes)
        };
        let music = steps.music.insert_axis(Axis(0));
        let mut inputs: Inputs<'_> = vec![
            ("upper".into(), half(0)?.into()),
            ("lower".into(), half(1)?.into()),
            ("music".into(), floats(GRAPH, music)?.into()),
            ("positions".into(), integers(GRAPH, 1, 0..count as i64)?.into()),
            ("attention_bias".into(), floats(GRAPH, prefill_bias(count).view())?.into()),
        ];
        for name in self.names.past.iter().flatten() {
            let shape = [1, self.heads, 0, self.head_size];
            let empty = Tensor::<f32>::new(&Allocator::default(), shape);
            inputs.push((name.clone(), tensor(GRAPH, empty)?.into()));
        }
        self.run(inputs, [1, count])
    }

    /// Runs the graph; `[batch, steps]` is the shape of its codes. The steps of the batch, or of
    /// the one sequence in it, are the rows of the logits.
    fn run(&mut self, inputs: Inputs<'_>, shape: [usize; 2]) -> Result<Run, ModelError> {
        let names = &self.names.present;
        self.graph.run(inputs, |outputs| {
            let mut logits = |name| -> Result<Array2<f32>, ModelError> {
                let logits = take_matrices(GRAPH, outputs, name, shape)?;
                let (batch, steps, codes) = logits.dim();
                let rows = logits.into_shape_with_order((batch * steps, codes));
                rows.map_err(|e| ModelError::Run { graph: GRAPH, problem: one_line(&e) })
            };
            let logits = Logits { upper: logits("upper_logits")?, lower: logits("lower_logits")? };
            let present = names
                .iter()
                .map(|[key, value]| Ok([take(GRAPH, outputs, key)?, take(GRAPH, outputs, value)?]));
            let present = present.collect::<Result<_, ModelError>>()?;
            Ok(Run { logits, present })
        })
    }
}

/// The cross-conditional causal mask of `count` steps from position 0 on,
/// `[1, 1, 3 count, 3 count]`: a token sees the steps up to its own in all three streams.
fn prefill_bias(count: usize) -> Array4<f32> {
    let tokens = STREAMS * count;
    Array4::from_shape_fn((1, 1, tokens, tokens), |(_, _, query, key)| {
        match key % count > query % count {
            true => HIDDEN,
            false => 0.0,
        }
    })
}

/// Hides the slots of the first rows of `cache` that are not filled, `[rows, 1, 3, tokens]`; the
/// newest step's tokens are the last.
fn step_bias(cache: &KvCache, rows: usize) -> Array4<f32> {
    let slots = cache.shape().tokens();
    Array4::from_shape_fn((rows, 1, STREAMS, slots + STREAMS), |(row, _, _, key)| {
        let empty = STREAMS * cache.steps(row)..slots;
        if empty.contains(&key) { HIDDEN } else { 0.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prefill_repeats_the_triangle_over_streams() {
        let bias = prefill_bias(4);
        assert_eq!(bias.dim(), (1, 1, 12, 12));
        for ((_, _, query, key), &bias) in bias.indexed_iter() {
            let visible = key % 4 <= query % 4;
            assert_eq!(bias == 0.0, visible, "query {query} key {key}");
        }
    }

    #[test]
    fn a_step_sees_the_filled_slots_and_itself() {
        let shape = RowShape { heads: 1, steps: 2, head_size: 1 };
        let mut cache = KvCache::new(2, 1, shape);
        let present: &[f32] = &[0.0; 3];
        let appended = cache.append(GRAPH, 1..2, 1, &[[present, present]]);
        appended.unwrap();
        let bias = step_bias(&cache, 2);
        assert_eq!(bias.dim(), (2, 1, 3, 9));
        for ((row, _, _, key), &bias) in bias.indexed_iter() {
            let visible = key < 3 * row || key >= 6;
            assert_eq!(bias == 0.0, visible, "row {row} key {key}");
        }
    }
}
