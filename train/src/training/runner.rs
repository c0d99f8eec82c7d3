//! The loop that all stages share: steps, tests, progress, metrics, checkpoints, resuming.

use std::{
    fs::{self, File, TryLockError},
    io::Write,
    path::{Path, PathBuf},
    time::Instant,
};

use burn_tensor::Tensor as Device;

use super::{
    TrainError, TrainingConfig, config::RunConfig, keep::CHECKPOINT_FILE, metrics::Metrics,
    plots::Plots, progress::Progress, saved::Saved, state::State,
};
use crate::nn::{Parameters, Store, Trainable};

/// Prefix of the weights in a stage's checkpoint.
pub(super) const WEIGHT: &str = "weight.";

/// Held while a stage runs in its folder.
const LOCK_FILE: &str = "lock";

/// What a stage does in a step, and what it keeps beside weights.
pub(super) trait Work<A: Trainable> {
    /// Names of the metrics; the first is the loss.
    const COLUMNS: &'static [&'static str];
    /// Names of the metrics on the test split, the first is the loss that the best checkpoint is kept by; empty: none.
    const TEST_COLUMNS: &'static [&'static str] = &[];
    /// The loss to follow downhill, and the metrics, one number each.
    fn step(&mut self, parameters: &Parameters<A>, step: u64) -> Losses<A>;
    /// How many earlier steps moved the weights that `step` moves: what Adam corrects its averages
    /// for.
    fn earlier_updates(&self, step: u64) -> u64 {
        step
    }
    /// How fast the weights of this name learn, in units of the stage's rate; 0: they stay as they are, though the
    /// loss may have a derivative for them.
    fn rate_factor(&self, name: &str) -> f64 {
        let _ = name;
        1.0
    }
    /// The metrics on the test split, without derivatives, dropout or change of any state; `None` where there is no test split.
    fn test(&self, parameters: &Parameters<A::InnerBackend>) -> Option<Vec<f32>> {
        let _ = parameters;
        None
    }
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

/// The folder of a stage.
pub(super) fn stage_folder(run: &RunConfig, stage: &str) -> PathBuf {
    run.folder.join(stage)
}

/// The checkpoint of a stage.
pub(super) fn checkpoint_path(run: &RunConfig, stage: &str) -> PathBuf {
    stage_folder(run, stage).join(CHECKPOINT_FILE)
}

/// Runs a stage from its checkpoint, or from the plan's weights, to its end or a limit.
pub(super) fn run<A: Trainable, W: Work<A>>(
    plan: &Plan<'_>,
    work: &mut W,
    device: &A::Device,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let folder = stage_folder(plan.run, plan.name);
    fs::create_dir_all(&folder).map_err(TrainError::file(&folder))?;
    let _lock = lock(&folder)?;
    let mut state = State::<A>::start(plan, work, device, &folder)?;
    let (columns, test_columns) = (W::COLUMNS, W::TEST_COLUMNS);
    let path = folder.join("metrics.csv");
    let metrics = Metrics::open(path, columns, test_columns, state.step)?;
    let total = plan.training.total_steps(plan.windows);
    let first_step = state.step;
    let mut journal = Journal {
        total,
        metrics,
        progress: Progress::start(plan.name, first_step, total),
        output,
    };
    let mut plots = Plots::new(folder, plan.name);
    let mut saved_at = Instant::now();
    while state.step < total {
        let step = state.step;
        A::seed(
            device,
            plan.run.seed ^ step.wrapping_mul(0x9E37_79B9_7F4A_7C15),
        );
        let rate = plan.training.rate_at(step, total);
        state.advance(plan.training, work, rate);
        journal.report(plan, work, &mut state)?;
        let done = state.step;
        let paused = limits.steps.is_some_and(|most| done - first_step >= most)
            || limits
                .seconds
                .is_some_and(|most| journal.progress.seconds() >= most);
        let stops = done == total || paused;
        if stops || saved_at.elapsed().as_secs_f64() >= plan.run.checkpoint_seconds {
            journal.metrics.sync()?;
            // Last of all the checkpoint: once it says that the stage is finished, nothing is done again.
            plots.draw(stops, journal.output);
            state.save(plan, work, total)?;
            saved_at = Instant::now();
        }
        if paused && done < total {
            return Ok(Outcome::Paused);
        }
    }
    Ok(Outcome::Finished)
}

/// Keeps other processes out of a stage's folder until the lock is dropped or this process dies.
fn lock(folder: &Path) -> Result<File, TrainError> {
    let path = folder.join(LOCK_FILE);
    let file = File::create(&path).map_err(TrainError::file(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(TrainError::Busy {
            folder: folder.to_owned(),
        }),
        Err(TryLockError::Error(source)) => Err(TrainError::File { path, source }),
    }
}

/// Where a stage tells how far it is.
struct Journal<'a, O> {
    /// Steps of the whole stage.
    total: u64,
    metrics: Metrics,
    progress: Progress,
    output: &'a mut O,
}

impl<O: Write> Journal<'_, O> {
    /// What there is to say about the last step: a test, a line of metrics, a line of progress.
    fn report<A: Trainable, W: Work<A>>(
        &mut self,
        plan: &Plan<'_>,
        work: &W,
        state: &mut State<A>,
    ) -> Result<(), TrainError> {
        let (done, run) = (state.step, plan.run);
        let due = |every: u64| every > 0 && (done.is_multiple_of(every) || done == self.total);
        let test_due = due(run.test_steps) && !W::TEST_COLUMNS.is_empty();
        if !test_due && !due(run.log_steps) {
            return Ok(());
        }
        let means = state.means::<W>(plan.name)?;
        let tests = if test_due {
            state.test(plan, work)?
        } else {
            None
        };
        let rate = plan.training.rate_at(done - 1, self.total);
        self.metrics.append(done, rate, &means, tests.as_deref())?;
        let mut losses = format!("loss {:.5}", means.first().unwrap_or(&f32::NAN));
        for (column, value) in W::TEST_COLUMNS.iter().zip(tests.iter().flatten()) {
            losses.push_str(&format!("  {column} {value:.5}"));
        }
        if let Some(best) = state.best.filter(|_| tests.is_some()) {
            losses.push_str(&format!("  (best {:.5} at {})", best.value, best.step));
        }
        self.progress.show(done, &losses, self.output);
        Ok(())
    }
}
