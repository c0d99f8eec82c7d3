//! The motion GPT as a step graph with a key/value cache (paper Eq. 4-6, ARCHITECTURE section 3).

use std::path::Path;

use ndarray::{Array2, Array4, ArrayView1, ArrayView2, Axis};
use ort::{
    memory::Allocator,
    session::SessionInputValue,
    value::{DynValue, Tensor},
};

use super::{
    Manifest, ModelError,
    memory::{GptMemory, RowShape, STREAMS},
    session::{
        Graph, Inputs, floats, integer_columns, integers, take, take_matrices, take_matrix, tensor,
    },
};
use bailando_core::CancelToken;

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

/// Keys and values of the steps seen so far, one pair per layer.
#[derive(Debug)]
pub struct KvCache {
    layers: Vec<(DynValue, DynValue)>,
    steps: usize,
}

impl KvCache {
    /// Steps that the cache holds.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.steps
    }
}

/// Consecutive steps to run: each step is one music row, one upper and one lower code.
#[derive(Clone, Copy, Debug)]
pub struct Steps<'a> {
    /// Upper codes `[steps]`.
    pub upper: &'a [u32],
    /// Lower codes `[steps]`.
    pub lower: &'a [u32],
    /// The music rows beside them `[steps, columns]`.
    pub music: ArrayView2<'a, f32>,
}

/// The newest step of a dance.
#[derive(Clone, Copy, Debug)]
pub struct NextStep<'a> {
    /// Upper code.
    pub upper: u32,
    /// Lower code.
    pub lower: u32,
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

#[derive(Debug)]
struct CacheNames {
    past: Vec<(String, String)>,
    present: Vec<(String, String)>,
}

impl CacheNames {
    fn new(layers: usize) -> Self {
        let pairs = |when: &str| {
            (0..layers)
                .map(|i| (format!("{when}_key.{i}"), format!("{when}_value.{i}")))
                .collect()
        };
        Self {
            past: pairs("past"),
            present: pairs("present"),
        }
    }
}

impl Gpt {
    /// Loads the graph at `path`, sized by `manifest`.
    ///
    /// # Errors
    /// [`ModelError::Graph`], [`ModelError::Mismatch`] or [`ModelError::Runtime`].
    pub fn open(path: &Path, manifest: &Manifest, threads: usize) -> Result<Self, ModelError> {
        // Steps have one shape for a number of dances, primes one for a number of steps.
        let graph = Graph::open(GRAPH, path, threads, true)?;
        let spec = manifest.gpt;
        let names = CacheNames::new(spec.layers);
        let mut inputs: Vec<String> = ["upper", "lower", "music", "positions", "attention_bias"]
            .map(str::to_owned)
            .to_vec();
        inputs.extend(
            names
                .past
                .iter()
                .flat_map(|(key, value)| [key.clone(), value.clone()]),
        );
        graph.expect_inputs(path, &inputs)?;
        Ok(Self {
            graph,
            names,
            heads: spec.heads,
            head_size: spec.channels / spec.heads.max(1),
            block: spec.block,
            context: spec.context,
            columns: manifest.features.columns,
        })
    }

    /// A cache that has seen nothing.
    ///
    /// # Errors
    /// [`ModelError::Run`] when the runtime cannot make tensors.
    pub fn empty_cache(&self) -> Result<KvCache, ModelError> {
        let empty = || {
            let shape = [1, self.heads, 0, self.head_size];
            tensor(GRAPH, Tensor::<f32>::new(&Allocator::default(), shape))
        };
        let layers = self
            .names
            .past
            .iter()
            .map(|_| Ok((empty()?, empty()?)))
            .collect::<Result<_, _>>()?;
        Ok(KvCache { layers, steps: 0 })
    }

    /// Runs `steps` after those in `cache`, which then holds them as well, and returns their
    /// logits.
    ///
    /// # Errors
    /// As [`Gpt::run_after`]; the cache is unchanged then.
    pub fn run(
        &mut self,
        steps: Steps<'_>,
        cache: &mut KvCache,
        cancel: &CancelToken,
    ) -> Result<Logits, ModelError> {
        let (logits, longer) = self.run_after(steps, cache, cancel)?;
        *cache = longer;
        Ok(logits)
    }

    /// Runs `steps` after those in `cache` and returns their logits and a cache that holds them as
    /// well. Positions go on from the cache's length (ARCHITECTURE: re-indexed from 0).
    ///
    /// # Errors
    /// [`ModelError::Input`] when lengths do not fit, [`ModelError::Cancelled`], or
    /// [`ModelError::Run`].
    pub fn run_after(
        &mut self,
        steps: Steps<'_>,
        cache: &KvCache,
        cancel: &CancelToken,
    ) -> Result<(Logits, KvCache), ModelError> {
        let count = self.check(&steps, cache)?;
        let inputs = self.inputs(steps, count, cache)?;
        let present = &self.names.present;
        let (logits, layers) = self.graph.run(inputs, cancel, |outputs| {
            let logits = Logits {
                upper: take_matrix(GRAPH, outputs, "upper_logits", count)?,
                lower: take_matrix(GRAPH, outputs, "lower_logits", count)?,
            };
            // Moving outputs back in as the next inputs copies nothing (STACK.md).
            let layers = present
                .iter()
                .map(|(key, value)| Ok((take(GRAPH, outputs, key)?, take(GRAPH, outputs, value)?)))
                .collect::<Result<Vec<_>, ModelError>>()?;
            Ok((logits, layers))
        })?;
        let steps = cache.steps + count;
        Ok((logits, KvCache { layers, steps }))
    }

    /// Memory for dances side by side, `rows` at most.
    #[must_use]
    pub fn memory(&self, rows: usize) -> GptMemory {
        let shape = RowShape {
            heads: self.heads,
            // The newest step of a whole window is not remembered: the window moves next.
            steps: self.context.saturating_sub(1).max(1),
            head_size: self.head_size,
        };
        GptMemory::new(rows, self.names.past.len(), shape)
    }

    /// Makes a row of `memory` remember `steps`, from position 0 on, and nothing else.
    ///
    /// # Errors
    /// As [`Gpt::run_after`]; also for more steps than a row remembers. The row is forgotten then.
    pub fn prime(
        &mut self,
        memory: &mut GptMemory,
        row: usize,
        steps: Steps<'_>,
        cancel: &CancelToken,
    ) -> Result<(), ModelError> {
        memory.forget(row);
        let count = steps.upper.len();
        if row >= memory.rows() || count > memory.shape().steps {
            return Err(ModelError::Input {
                what: "GPT memory",
                expected: format!("{} rows of {} steps", memory.rows(), memory.shape().steps),
                got: format!("{count} steps for row {row}"),
            });
        }
        let (_, cache) = self.run_after(steps, &self.empty_cache()?, cancel)?;
        let layers = cache.layers.into_iter();
        let layers: Vec<_> = layers.map(|(key, value)| [key, value]).collect();
        memory.append(GRAPH, row..row + 1, count, &layers)
    }

    /// One step more of each dance in the first rows of `memory`, which then remember it as well, and the
    /// logits that follow, a row each: the same as if each were alone. Not interruptible, as it serves
    /// many.
    ///
    /// # Errors
    /// [`ModelError::Input`] when there are more dances than rows, or music of another width;
    /// [`ModelError::Run`]. Memory is unchanged then.
    pub fn step(
        &mut self,
        memory: &mut GptMemory,
        next: &[NextStep<'_>],
    ) -> Result<Logits, ModelError> {
        let dances = next.len();
        let fits = next.iter().all(|step| step.music.len() == self.columns);
        if dances == 0 || dances > memory.rows() || !fits {
            return Err(ModelError::Input {
                what: "GPT steps",
                expected: format!(
                    "1 to {} beside music of {} columns",
                    memory.rows(),
                    self.columns
                ),
                got: format!("{dances}, or music of another width"),
            });
        }
        let inputs = self.next_inputs(memory, next)?;
        let present = &self.names.present;
        let (logits, layers) = self.graph.run(inputs, &CancelToken::new(), |outputs| {
            let newest = |outputs: &mut _, name| -> Result<Array2<f32>, ModelError> {
                let logits = take_matrices(GRAPH, outputs, name, [dances, 1])?;
                Ok(logits.index_axis_move(Axis(1), 0))
            };
            let logits = Logits {
                upper: newest(outputs, "upper_logits")?,
                lower: newest(outputs, "lower_logits")?,
            };
            let layers = present
                .iter()
                .map(|(key, value)| Ok([take(GRAPH, outputs, key)?, take(GRAPH, outputs, value)?]))
                .collect::<Result<Vec<_>, ModelError>>()?;
            Ok((logits, layers))
        })?;
        memory.append(GRAPH, 0..dances, 1, &layers)?;
        Ok(logits)
    }

    fn next_inputs<'memory>(
        &self,
        memory: &'memory GptMemory,
        next: &[NextStep<'_>],
    ) -> Result<Inputs<'memory>, ModelError> {
        let column = |number: &dyn Fn(usize, &NextStep<'_>) -> i64| {
            let numbers = next.iter().enumerate().map(|(row, step)| number(row, step));
            integer_columns(GRAPH, numbers.collect())
        };
        let music: Vec<f32> = next.iter().flat_map(|step| step.music).copied().collect();
        let music = ort::value::Tensor::from_array(([next.len(), 1, self.columns], music));
        let bias = next_bias(memory, next.len());
        let mut inputs: Inputs<'memory> = vec![
            (
                "upper".into(),
                column(&|_, step| i64::from(step.upper))?.into(),
            ),
            (
                "lower".into(),
                column(&|_, step| i64::from(step.lower))?.into(),
            ),
            ("music".into(), tensor(GRAPH, music)?.into()),
            (
                "positions".into(),
                column(&|row, _| memory.steps(row) as i64)?.into(),
            ),
            ("attention_bias".into(), floats(GRAPH, bias.view())?.into()),
        ];
        let layers = memory.first(GRAPH, next.len())?;
        for ((key_name, value_name), [key, value]) in self.names.past.iter().zip(layers) {
            inputs.push((key_name.clone(), key.into()));
            inputs.push((value_name.clone(), value.into()));
        }
        Ok(inputs)
    }

    fn check(&self, steps: &Steps<'_>, cache: &KvCache) -> Result<usize, ModelError> {
        let count = steps.upper.len();
        if count == 0 || steps.lower.len() != count || steps.music.dim() != (count, self.columns) {
            return Err(ModelError::Input {
                what: "GPT steps",
                expected: format!("as many codes per half as rows of {} columns", self.columns),
                got: format!(
                    "{count} upper codes, {} lower codes, {:?} music",
                    steps.lower.len(),
                    steps.music.dim()
                ),
            });
        }
        if cache.steps + count > self.block {
            return Err(ModelError::Input {
                what: "GPT steps",
                expected: format!("at most {} in a window", self.block),
                got: format!("{} cached and {count} new", cache.steps),
            });
        }
        Ok(count)
    }

    fn inputs<'cache>(
        &self,
        steps: Steps<'_>,
        count: usize,
        cache: &'cache KvCache,
    ) -> Result<Inputs<'cache>, ModelError> {
        let codes = |codes: &[u32]| integers(GRAPH, codes.iter().map(|&code| i64::from(code)));
        let positions = (cache.steps..cache.steps + count).map(|row| row as i64);
        let bias = attention_bias(cache.steps, count);
        let music = steps.music.insert_axis(ndarray::Axis(0));
        let mut inputs: Inputs<'cache> = vec![
            ("upper".into(), codes(steps.upper)?.into()),
            ("lower".into(), codes(steps.lower)?.into()),
            ("music".into(), floats(GRAPH, music)?.into()),
            ("positions".into(), integers(GRAPH, positions)?.into()),
            ("attention_bias".into(), floats(GRAPH, bias.view())?.into()),
        ];
        for ((key_name, value_name), (key, value)) in self.names.past.iter().zip(&cache.layers) {
            inputs.push((key_name.clone(), SessionInputValue::from(key)));
            inputs.push((value_name.clone(), SessionInputValue::from(value)));
        }
        Ok(inputs)
    }
}

/// The cross-conditional causal mask for `count` new steps after `past` cached ones,
/// `[1, 1, 3 count, 3 (past + count)]`: a token sees the whole cache, and of the new steps those up
/// to its own in all three streams. For a single step nothing is hidden.
fn attention_bias(past: usize, count: usize) -> Array4<f32> {
    let cached = STREAMS * past;
    Array4::from_shape_fn(
        (1, 1, STREAMS * count, cached + STREAMS * count),
        |(_, _, query, key)| match key.checked_sub(cached) {
            Some(new) if new % count > query % count => HIDDEN,
            _ => 0.0,
        },
    )
}

/// Hides the slots of the first rows of `memory` that are not filled, `[rows, 1, 3, tokens]`; the newest
/// step's tokens are the last.
fn next_bias(memory: &GptMemory, rows: usize) -> Array4<f32> {
    let slots = memory.shape().tokens();
    Array4::from_shape_fn((rows, 1, STREAMS, slots + STREAMS), |(row, _, _, key)| {
        let empty = STREAMS * memory.steps(row)..slots;
        if empty.contains(&key) { HIDDEN } else { 0.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_step_hides_nothing() {
        assert!(attention_bias(7, 1).iter().all(|&bias| bias == 0.0));
    }

    #[test]
    fn priming_repeats_the_triangle_over_streams() {
        let bias = attention_bias(2, 4);
        assert_eq!(bias.dim(), (1, 1, 12, 18));
        for query in 0..12 {
            for key in 0..18 {
                let visible = key < 6 || (key - 6) % 4 <= query % 4;
                assert_eq!(
                    bias[[0, 0, query, key]] == 0.0,
                    visible,
                    "query {query} key {key}"
                );
            }
        }
    }
}
