//! What was measured, as JSON and as a table.

use std::fmt::Write;

use serde::Serialize;

use super::baseline::Baseline;
use crate::model::WeightStorage;

/// All that a run of the bench measured.
#[derive(Clone, Debug, Serialize)]
pub struct Bench {
    /// What on.
    pub machine: Machine,
    /// The model's name.
    pub model: String,
    /// How its weights are stored.
    pub weights: WeightStorage,
    /// Threads of a step wherever nothing else is said.
    pub threads: usize,
    /// From nothing to ready, the checks of the model included.
    pub start_s: f64,
    /// Memory of the process before the model was loaded.
    pub resident_before_start_bytes: Option<u64>,
    /// The same with the model loaded.
    pub resident_idle_bytes: Option<u64>,
    /// The most of the whole run.
    pub resident_peak_bytes: Option<u64>,
    /// Stages of a generation.
    pub stages: Vec<Stage>,
    /// Steps of the GPT, by number of threads.
    pub steps: Vec<ThreadSteps>,
    /// Dances at once.
    pub throughput: Throughput,
    /// Latencies by number of callers.
    pub load: Vec<LoadPoint>,
    /// Cost by length.
    pub lengths: Vec<LengthPoint>,
}

/// A machine.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Name of the processor.
    pub cpu: String,
    /// What it has for vectors.
    pub vectors: Vec<String>,
    /// Cores that the process may use.
    pub cores: usize,
    /// Operating system and architecture.
    pub system: String,
}

/// Median seconds of a stage.
#[derive(Clone, Debug, Serialize)]
pub struct Stage {
    /// Name, for programs.
    pub name: String,
    /// Threads at most.
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
    /// Seconds of reading them.
    pub floor_s: f64,
    /// Steps by batch.
    pub steps: Vec<StepPoint>,
    /// Steps of the prime that was measured.
    pub prime_steps: usize,
    /// Its seconds.
    pub prime_s: f64,
    /// Codes that the model's window keeps when it moves.
    pub hop: usize,
    /// Seconds of a code with the model's window, priming included.
    pub code_s: f64,
}

/// One step of a number of dances.
#[derive(Clone, Debug, Serialize)]
pub struct StepPoint {
    /// Dances.
    pub batch: usize,
    /// Seconds.
    pub seconds: f64,
}

/// Dances at once against one after another.
#[derive(Clone, Debug, Serialize)]
pub struct Throughput {
    /// How many.
    pub dances: usize,
    /// Codes of all.
    pub codes: usize,
    /// Seconds when each waits for the one before.
    pub one_after_another_s: f64,
    /// Seconds when they share steps.
    pub at_once_s: f64,
    /// Whether every dance has the same codes both ways.
    pub same_codes: bool,
}

/// Latencies of a whole song under load.
#[derive(Clone, Debug, Serialize)]
pub struct LoadPoint {
    /// Callers at the same time.
    pub callers: usize,
    /// Dances generated.
    pub dances: usize,
    /// Of all callers together.
    pub dances_per_second: f64,
    /// Half took less.
    pub p50_s: f64,
    /// 95 % took less.
    pub p95_s: f64,
    /// 99 % took less.
    pub p99_s: f64,
}

/// Cost of a song of some length, up to its BVH.
#[derive(Clone, Debug, Serialize)]
pub struct LengthPoint {
    /// Seconds of music.
    pub seconds: f64,
    /// Frames of the dance.
    pub frames: usize,
    /// Seconds it took.
    pub elapsed_s: f64,
    /// Most memory of the process so far.
    pub resident_peak_bytes: Option<u64>,
}

impl Bench {
    /// Seconds of a stage.
    #[must_use]
    pub fn stage(&self, name: &str) -> Option<f64> {
        let stage = self.stages.iter().find(|stage| stage.name == name);
        stage.map(|stage| stage.seconds)
    }

    /// Markdown tables; ratios to the baseline where there is one.
    #[must_use]
    pub fn markdown(&self, baseline: Option<&Baseline>) -> String {
        let mut text = String::new();
        // Writing to a string can't fail.
        let _ = self.write(&mut text, baseline);
        text
    }

    fn write(&self, text: &mut String, baseline: Option<&Baseline>) -> std::fmt::Result {
        let Machine {
            cpu,
            vectors,
            cores,
            system,
        } = &self.machine;
        writeln!(
            text,
            "{cores} cores of {cpu} ({}), {system}; model {} ({}), {} threads a step\n",
            vectors.join(", "),
            self.model,
            storage_name(self.weights),
            self.threads
        )?;
        writeln!(
            text,
            "| stage | threads | seconds | baseline |\n|---|---|---|---|"
        )?;
        for stage in &self.stages {
            let reference = baseline.and_then(|baseline| baseline.stage(&stage.name));
            let ratio = reference.map_or_else(String::new, |reference| {
                format!(
                    "{:.1} x faster than {reference:.2} s",
                    reference / stage.seconds
                )
            });
            writeln!(
                text,
                "| {} | {} | {:.3} | {ratio} |",
                stage.name, stage.threads, stage.seconds
            )?;
        }
        writeln!(
            text,
            "| start to ready | {} | {:.2} | |",
            self.threads, self.start_s
        )?;
        self.write_steps(text, baseline)?;
        self.write_load(text)?;
        self.write_memory(text)
    }

    fn write_steps(&self, text: &mut String, baseline: Option<&Baseline>) -> std::fmt::Result {
        writeln!(
            text,
            "\n| step of the GPT, milliseconds | {} |",
            joined(&self.steps, |steps| format!("{} threads", steps.threads))
        )?;
        writeln!(text, "|---|{}", "---|".repeat(self.steps.len()))?;
        let mut row = |title: &str, cell: &dyn Fn(&ThreadSteps) -> String| {
            writeln!(text, "| {title} | {} |", joined(&self.steps, cell))
        };
        let ms = |seconds: f64| format!("{:.2}", 1e3 * seconds);
        row("reading the weights once", &|steps| {
            format!(
                "{} ({:.0} MB)",
                ms(steps.floor_s),
                steps.weight_bytes as f64 / 1e6
            )
        })?;
        let batches = self.steps.first().map_or(&[][..], |steps| &steps.steps);
        for (place, point) in batches.iter().enumerate() {
            let title = format!("{} at once", point.batch);
            row(&title, &|steps| {
                let seconds = steps
                    .steps
                    .get(place)
                    .map_or(f64::NAN, |point| point.seconds);
                match place {
                    0 => format!("{} ({:.2} x reading)", ms(seconds), seconds / steps.floor_s),
                    _ => ms(seconds),
                }
            })?;
        }
        row("prime", &|steps| {
            let step = steps.steps.first().map_or(f64::NAN, |point| point.seconds);
            format!(
                "{} ({} steps, {:.1} x a step)",
                ms(steps.prime_s),
                steps.prime_steps,
                steps.prime_s / step
            )
        })?;
        row("a code, primes included", &|steps| {
            let reference = baseline.and_then(|baseline| baseline.code_s(steps.threads));
            let ratio = reference.map_or_else(String::new, |reference| {
                format!(
                    ", {:.1} x faster than {}",
                    reference / steps.code_s,
                    ms(reference)
                )
            });
            format!("{} (hop {}){ratio}", ms(steps.code_s), steps.hop)
        })
    }

    fn write_load(&self, text: &mut String) -> std::fmt::Result {
        let Throughput {
            dances,
            codes,
            one_after_another_s,
            at_once_s,
            same_codes,
        } = &self.throughput;
        writeln!(
            text,
            "\n{dances} dances of {codes} codes in all: {one_after_another_s:.2} s one after another, \
            {at_once_s:.2} s at once ({:.2} x), {} codes\n",
            one_after_another_s / at_once_s,
            if *same_codes { "the same" } else { "OTHER" }
        )?;
        writeln!(
            text,
            "| callers | dances a second | p50 s | p95 s | p99 s |\n|---|---|---|---|---|"
        )?;
        for point in &self.load {
            writeln!(
                text,
                "| {} | {:.2} | {:.2} | {:.2} | {:.2} |",
                point.callers, point.dances_per_second, point.p50_s, point.p95_s, point.p99_s
            )?;
        }
        Ok(())
    }

    fn write_memory(&self, text: &mut String) -> std::fmt::Result {
        let mb = |bytes: Option<u64>| {
            bytes.map_or("?".into(), |bytes| format!("{:.0}", bytes as f64 / 1e6))
        };
        writeln!(
            text,
            "\n| song, s | seconds | x the first | peak memory so far, MB |\n|---|---|---|---|"
        )?;
        let first = self
            .lengths
            .first()
            .map_or(f64::NAN, |point| point.elapsed_s);
        for point in &self.lengths {
            writeln!(
                text,
                "| {:.0} | {:.2} | {:.2} | {} |",
                point.seconds,
                point.elapsed_s,
                point.elapsed_s / first,
                mb(point.resident_peak_bytes)
            )?;
        }
        writeln!(
            text,
            "\nMemory in MB: {} before the model is loaded, {} idle, {} at most",
            mb(self.resident_before_start_bytes),
            mb(self.resident_idle_bytes),
            mb(self.resident_peak_bytes)
        )
    }
}

fn joined(steps: &[ThreadSteps], cell: impl Fn(&ThreadSteps) -> String) -> String {
    steps.iter().map(cell).collect::<Vec<_>>().join(" | ")
}

fn storage_name(weights: WeightStorage) -> &'static str {
    match weights {
        WeightStorage::F32 => "f32",
        WeightStorage::F16 => "f16, computed as f32",
        WeightStorage::Int8 => "int8",
    }
}
