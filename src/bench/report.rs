//! The figures of a bench; serialised, they are its JSON.

use serde::Serialize;

use crate::model::WeightStorage;

/// All figures of one run.
#[derive(Clone, Debug, Serialize)]
pub struct Bench {
    /// The machine.
    pub machine: Machine,
    /// Name of the model.
    pub model: String,
    /// Storage of its weights.
    pub weights: WeightStorage,
    /// What computes it.
    pub device: String,
    /// Threads of a step unless a figure says otherwise.
    pub threads: usize,
    /// Seconds from nothing to ready, the checks of the model included.
    pub start_s: f64,
    /// Memory of the process before the model was loaded.
    pub resident_before_start_bytes: Option<u64>,
    /// Memory with the model loaded.
    pub resident_idle_bytes: Option<u64>,
    /// Most memory of the whole run.
    pub resident_peak_bytes: Option<u64>,
    /// Stages of a generation.
    pub stages: Vec<Stage>,
    /// Steps of the GPT, by number of threads.
    pub steps: Vec<ThreadSteps>,
    /// Generations at once.
    pub throughput: Throughput,
    /// Latencies by number of callers.
    pub load: Vec<LoadPoint>,
    /// Cost by length.
    pub lengths: Vec<LengthPoint>,
}

/// The machine of a bench.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Name of the processor.
    pub cpu: String,
    /// Its vector instructions.
    pub vectors: Vec<String>,
    /// Cores that the process may use.
    pub cores: usize,
    /// Operating system and architecture.
    pub system: String,
}

/// Median seconds of a stage.
#[derive(Clone, Debug, Serialize)]
pub struct Stage {
    /// Its name.
    pub name: String,
    /// Most threads.
    pub threads: usize,
    /// Seconds.
    pub seconds: f64,
}

/// Steps with some number of threads.
#[derive(Clone, Debug, Serialize)]
pub struct ThreadSteps {
    /// Threads.
    pub threads: usize,
    /// Bytes of weights that a step reads.
    pub weight_bytes: usize,
    /// Seconds of reading them once.
    pub floor_s: f64,
    /// Steps by batch.
    pub steps: Vec<StepPoint>,
    /// Steps of the measured prefill.
    pub prefill_steps: usize,
    /// Its seconds.
    pub prefill_s: f64,
    /// Codes that the model's window keeps when it moves.
    pub hop: usize,
    /// Seconds of a code with the model's window, prefills included.
    pub code_s: f64,
}

/// One step of a number of sequences.
#[derive(Clone, Debug, Serialize)]
pub struct StepPoint {
    /// Sequences.
    pub batch: usize,
    /// Seconds.
    pub seconds: f64,
}

/// Generations at once, compared with one after another.
#[derive(Clone, Debug, Serialize)]
pub struct Throughput {
    /// Number of generations.
    pub dances: usize,
    /// Codes of all together.
    pub codes: usize,
    /// Seconds one after another.
    pub one_after_another_s: f64,
    /// Seconds at once, with shared steps.
    pub at_once_s: f64,
    /// Whether every generation has the same codes both ways.
    pub same_codes: bool,
}

/// Latencies of a whole song under load.
#[derive(Clone, Debug, Serialize)]
pub struct LoadPoint {
    /// Callers at the same time.
    pub callers: usize,
    /// Generations.
    pub dances: usize,
    /// Generations per second of all callers together.
    pub dances_per_second: f64,
    /// Median latency, seconds.
    pub p50_s: f64,
    /// 95th percentile.
    pub p95_s: f64,
    /// 99th percentile.
    pub p99_s: f64,
}

/// Cost of a song of some length, BVH included.
#[derive(Clone, Debug, Serialize)]
pub struct LengthPoint {
    /// Seconds of music.
    pub seconds: f64,
    /// Frames of the motion.
    pub frames: usize,
    /// Seconds of work.
    pub elapsed_s: f64,
    /// Most memory of the process so far.
    pub resident_peak_bytes: Option<u64>,
}
