//! The loop that all stages share: steps, progress, metrics, checkpoints, resuming.

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    time::Instant,
};

use burn_tensor::Tensor as Device;

use super::{TrainError, TrainingConfig, adam::Adam, adam::clip, config::RunConfig, saved::Saved};
use crate::{
    Tensor,
    nn::{Parameters, Store, Trainable, values},
};

const FIRST_MOMENT: &str = "adam.first.";
const SECOND_MOMENT: &str = "adam.second.";
const METERS: &str = "meters";
/// Prefix of the weights in a stage's checkpoint.
pub(super) const WEIGHT: &str = "weight.";

/// What a stage does in a step, and what it keeps beside weights.
pub(super) trait Work<A: Trainable> {
    /// Names of the metrics; the first is the loss.
    const COLUMNS: &'static [&'static str];
    /// Names of the metrics on the test split, the first is the loss that the best checkpoint is kept by; empty: none.
    #[allow(dead_code, reason = "of the test split")]
    const TEST_COLUMNS: &'static [&'static str] = &[];
    /// The metrics on the test split, without derivatives, dropout or change of any state; `None` where there is no test split.
    #[allow(dead_code, reason = "of the test split")]
    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let _ = parameters;
        None
    }
    /// The loss to follow downhill, and the metrics, one number each.
    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A>;
    /// Takes what it keeps beside weights into a checkpoint.
    fn save(&self, saved: &mut Saved);
    /// And back.
    fn restore(&mut self, saved: &Saved) -> Result<(), String>;
}

pub(super) struct Losses<A: Trainable> {
    pub(super) loss: Device<A, 1>,
    pub(super) metrics: Vec<Device<A::InnerBackend, 1>>,
}

/// What a stage is called, how it is set, and where it starts.
pub(super) struct Plan<'a> {
    pub(super) name: &'static str,
    pub(super) run: &'a RunConfig,
    pub(super) training: &'a TrainingConfig,
    /// All settings that the result depends on.
    pub(super) settings: String,
    pub(super) store: Store,
    pub(super) windows: usize,
}

/// When to pause before the end.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// After so many seconds.
    pub seconds: Option<f64>,
    /// After so many steps.
    pub steps: Option<u64>,
}

/// How a stage ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps are done.
    Finished,
    /// A limit was reached; the same command goes on.
    Paused,
}

/// The checkpoint of a stage.
pub(super) fn checkpoint_path(run: &RunConfig, stage: &str) -> PathBuf {
    run.folder.join(stage).join("checkpoint.safetensors")
}

/// Runs a stage from its checkpoint, or from the plan's weights, to its end or a limit.
pub(super) fn run<A: Trainable, W: Work<A>>(
    plan: &Plan<'_>,
    work: &mut W,
    device: &A::Device,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let path = checkpoint_path(plan.run, plan.name);
    let folder = plan.run.folder.join(plan.name);
    fs::create_dir_all(&folder).map_err(TrainError::file(&folder))?;
    let mut state = State::<A>::start(plan, work, device, &path)?;
    let mut metrics = Metrics::open(folder.join("metrics.csv"), W::COLUMNS, state.step)?;
    let total = plan.training.total_steps(plan.windows);
    let (start, first_step) = (Instant::now(), state.step);
    let mut saved_at = Instant::now();
    while state.step < total {
        let step = state.step;
        A::seed(
            device,
            plan.run.seed ^ step.wrapping_mul(0x9E37_79B9_7F4A_7C15),
        );
        let rate = plan.training.rate_at(step, total);
        state.advance(plan.training, work, rate);
        let done = state.step;
        if done.is_multiple_of(plan.run.log_steps) || done == total {
            let means = state.means::<W>(plan.name)?;
            metrics.append(done, rate, &means)?;
            let each = start.elapsed().as_secs_f64() / (done - first_step) as f64;
            let left = each * (total - done) as f64 / 60.0;
            let loss = means.first().copied().unwrap_or(f32::NAN);
            // Progress that cannot be shown is no reason to stop.
            let _ = writeln!(
                output,
                "{} {done}/{total}  loss {loss:.5}  {each:.3} s/step  {left:.1} min left{}",
                plan.name,
                memory()
            );
        }
        let paused = limits.steps.is_some_and(|most| done - first_step >= most)
            || limits
                .seconds
                .is_some_and(|most| start.elapsed().as_secs_f64() >= most);
        let due = saved_at.elapsed().as_secs_f64() >= plan.run.checkpoint_seconds;
        if done == total || paused || due {
            metrics.sync()?;
            state.save(plan, work, &path, total)?;
            saved_at = Instant::now();
        }
        if paused && done < total {
            return Ok(Outcome::Paused);
        }
    }
    Ok(Outcome::Finished)
}

struct State<A: Trainable> {
    parameters: Parameters<A::InnerBackend>,
    adam: Adam<A::InnerBackend>,
    step: u64,
    /// Sums of the metrics since the last line.
    sums: Vec<Device<A::InnerBackend, 1>>,
    summed: f32,
}

impl<A: Trainable> State<A> {
    fn start<W: Work<A>>(
        plan: &Plan<'_>,
        work: &mut W,
        device: &A::Device,
        path: &Path,
    ) -> Result<Self, TrainError> {
        let parameters = Parameters::from_store(&plan.store, device);
        let mut state = Self {
            adam: Adam::new(parameters.tensors(), plan.training.betas),
            parameters,
            step: 0,
            sums: W::COLUMNS
                .iter()
                .map(|_| Device::zeros([1], device))
                .collect(),
            summed: 0.0,
        };
        if let Some(saved) = Saved::read(path)? {
            let failed = |message| TrainError::State {
                path: path.to_owned(),
                message,
            };
            state.restore(plan, work, &saved, device).map_err(failed)?;
        }
        Ok(state)
    }

    fn restore<W: Work<A>>(
        &mut self,
        plan: &Plan<'_>,
        work: &mut W,
        saved: &Saved,
        device: &A::Device,
    ) -> Result<(), String> {
        if saved.fact("settings") != plan.settings {
            return Err(format!(
                "made with other settings ({}): use another run.folder, or delete it",
                saved.fact("settings")
            ));
        }
        let step = saved.fact("step");
        self.step = step.parse().map_err(|_| format!("`{step}` is no step"))?;
        let load = |prefix: &str| -> Result<Parameters<A::InnerBackend>, String> {
            Ok(Parameters::from_store(
                &saved.fill(prefix, &plan.store)?,
                device,
            ))
        };
        self.parameters = load(WEIGHT)?;
        self.adam.first = load(FIRST_MOMENT)?.tensors().to_vec();
        self.adam.second = load(SECOND_MOMENT)?.tensors().to_vec();
        let meters = saved.tensor(METERS)?.data();
        let (summed, sums) = meters.split_first().ok_or("no meters")?;
        self.summed = *summed;
        for (sum, value) in self.sums.iter_mut().zip(sums) {
            *sum = Device::from_floats([*value], device);
        }
        work.restore(saved)
    }

    fn advance<W: Work<A>>(&mut self, training: &TrainingConfig, work: &mut W, rate: f64) {
        let tracked: Parameters<A> = self.parameters.tracked();
        let Losses { loss, metrics } = work.step(&tracked, self.step);
        let mut gradients = loss.backward();
        let tensors = tracked.tensors().iter();
        let mut gradients: Vec<_> = tensors.map(|t| t.grad_remove(&mut gradients)).collect();
        clip(&mut gradients, training.clip);
        self.adam
            .step(self.parameters.tensors_mut(), gradients, rate, self.step);
        for (sum, value) in self.sums.iter_mut().zip(metrics) {
            *sum = sum.clone() + value;
        }
        self.summed += 1.0;
        self.step += 1;
    }

    fn read_sums(&self) -> Vec<f32> {
        self.sums.iter().flat_map(values).collect()
    }

    /// Means since the last line; starts the next.
    fn means<W: Work<A>>(&mut self, stage: &'static str) -> Result<Vec<f32>, TrainError> {
        let means: Vec<f32> = self
            .read_sums()
            .iter()
            .map(|sum| sum / self.summed)
            .collect();
        self.check::<W>(&means, stage)?;
        self.summed = 0.0;
        for sum in &mut self.sums {
            *sum = sum.zeros_like();
        }
        Ok(means)
    }

    fn check<W: Work<A>>(&self, values: &[f32], stage: &'static str) -> Result<(), TrainError> {
        let wrong = W::COLUMNS
            .iter()
            .zip(values)
            .find(|(_, value)| !value.is_finite());
        wrong.map_or(Ok(()), |(column, &value)| {
            Err(TrainError::NotFinite {
                stage,
                column,
                value,
                step: self.step,
            })
        })
    }

    fn save<W: Work<A>>(
        &self,
        plan: &Plan<'_>,
        work: &W,
        path: &Path,
        total: u64,
    ) -> Result<(), TrainError> {
        let mut meters = vec![self.summed];
        meters.extend(self.read_sums());
        // A run that went wrong must not replace the checkpoint from before.
        self.check::<W>(meters.get(1..).unwrap_or_default(), plan.name)?;
        let mut saved = Saved::default();
        saved.put(WEIGHT, &self.parameters.to_store(&plan.store));
        let moments = [
            (FIRST_MOMENT, &self.adam.first),
            (SECOND_MOMENT, &self.adam.second),
        ];
        for (prefix, tensors) in moments {
            saved.put(
                prefix,
                &plan.store.with_values(tensors.iter().map(values).collect()),
            );
        }
        let meters = Tensor::from_fn(vec![meters.len()], |place| meters[place]);
        saved.tensors.insert(METERS.into(), meters);
        work.save(&mut saved);
        let facts = [
            ("stage", plan.name.to_owned()),
            ("step", self.step.to_string()),
            ("finished", (self.step >= total).to_string()),
            ("settings", plan.settings.clone()),
        ];
        saved.facts = facts.map(|(name, value)| (name.to_owned(), value)).into();
        saved.write(path)
    }
}

/// `metrics.csv`: only what depends on settings and seed, so that runs can be compared by bytes.
struct Metrics {
    path: PathBuf,
    file: fs::File,
}

impl Metrics {
    /// Lines beyond `step` are of a run that was killed after its checkpoint: they are taken off.
    fn open(path: PathBuf, columns: &[&str], step: u64) -> Result<Self, TrainError> {
        let old = fs::read_to_string(&path).unwrap_or_default();
        let mut text = format!("step,rate,{}\n", columns.join(","));
        for line in old.lines().skip(1) {
            let number = line
                .split(',')
                .next()
                .and_then(|number| number.parse::<u64>().ok());
            if number.is_some_and(|number| number <= step) {
                text.push_str(line);
                text.push('\n');
            }
        }
        fs::write(&path, text).map_err(TrainError::file(&path))?;
        let file = fs::OpenOptions::new().append(true).open(&path);
        let file = file.map_err(TrainError::file(&path))?;
        Ok(Self { path, file })
    }

    fn append(&mut self, step: u64, rate: f64, means: &[f32]) -> Result<(), TrainError> {
        let means: Vec<String> = means.iter().map(f32::to_string).collect();
        let line = format!("{step},{rate:e},{}\n", means.join(","));
        self.file
            .write_all(line.as_bytes())
            .map_err(TrainError::file(&self.path))
    }

    fn sync(&mut self) -> Result<(), TrainError> {
        self.file.sync_data().map_err(TrainError::file(&self.path))
    }
}

/// Most memory used so far, where the system tells.
fn memory() -> String {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.map_or_else(String::new, |kilobytes| {
        format!("  {:.2} GB at most", kilobytes / 1e6)
    })
}
