//! The loop that all stages share: steps, tests, progress, metrics, checkpoints, resuming.

use std::{
    fs::{self, File, TryLockError},
    io::Write,
    path::Path,
    time::Instant,
};

use super::{
    error::TrainError,
    kept::stage_folder,
    metrics::Metrics,
    plots::Plots,
    progress::Progress,
    state::State,
    stop::StopFlag,
    trainable::{StageSpec, TrainableStage},
};
use crate::nn::Trainable;

/// Held while a stage runs in its folder.
const LOCK_FILE: &str = "lock";

/// When to pause before the end.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// After so many seconds.
    pub seconds: Option<f64>,
    /// After so many steps.
    pub steps: Option<u64>,
    /// When this is raised.
    pub stop: Option<&'static StopFlag>,
}

impl Limits {
    fn are_reached(&self, seconds: f64, steps: u64) -> bool {
        self.steps.is_some_and(|most| steps >= most)
            || self.seconds.is_some_and(|most| seconds >= most)
            || self.stop.is_some_and(StopFlag::is_requested)
    }
}

/// How a stage ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps are done.
    Finished,
    /// A limit was reached; the same command resumes.
    Paused,
}

/// Runs a stage from its checkpoint, or from its first weights, to its end or a limit.
pub(super) fn run<A: Trainable, S: TrainableStage<A>>(
    spec: &StageSpec<'_>,
    stage: &mut S,
    device: &A::Device,
    limits: Limits,
    output: &mut impl Write,
) -> Result<Outcome, TrainError> {
    let folder = stage_folder(spec.run, spec.name);
    fs::create_dir_all(&folder).map_err(TrainError::file(&folder))?;
    let _lock = lock(&folder)?;
    let mut state = State::<A>::start(spec, stage, device, &folder)?;
    let path = folder.join("metrics.csv");
    let metrics = Metrics::open(path, S::COLUMNS, S::TEST_COLUMNS, state.step)?;
    let total = spec.training.total_steps(spec.windows);
    let first_step = state.step;
    let mut logger = MetricsLogger {
        total,
        metrics,
        progress: Progress::start(spec.name, first_step, total),
        output,
    };
    let mut plots = Plots::new(folder, spec.name);
    let mut saved_at = Instant::now();
    let _heeded = limits.stop.map(StopFlag::heeded);
    while state.step < total {
        let step = state.step;
        A::seed(device, spec.run.seed ^ step.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let rate = spec.training.rate_at(step, total);
        state.advance(spec.training, stage, rate);
        logger.report(spec, stage, &mut state)?;
        let done = state.step;
        let paused = limits.are_reached(logger.progress.seconds(), done - first_step);
        let stops = done == total || paused;
        if stops || saved_at.elapsed().as_secs_f64() >= spec.run.checkpoint_seconds {
            logger.metrics.sync()?;
            // The checkpoint comes last: once it has all steps, nothing is repeated.
            plots.draw(stops, logger.output);
            state.save(spec, stage)?;
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
        Err(TryLockError::WouldBlock) => Err(TrainError::Busy { folder: folder.to_owned() }),
        Err(TryLockError::Error(source)) => Err(TrainError::File { path, source }),
    }
}

/// Writes metrics and progress of a stage.
struct MetricsLogger<'a, O> {
    /// Steps of the whole stage.
    total: u64,
    metrics: Metrics,
    progress: Progress,
    output: &'a mut O,
}

impl<O: Write> MetricsLogger<'_, O> {
    /// Reports the last step where it is due: a test, a line of metrics, a line of progress.
    fn report<A: Trainable, S: TrainableStage<A>>(
        &mut self,
        spec: &StageSpec<'_>,
        stage: &S,
        state: &mut State<A>,
    ) -> Result<(), TrainError> {
        let (done, run) = (state.step, spec.run);
        let due = |every: u64| every > 0 && (done.is_multiple_of(every) || done == self.total);
        let test_due = due(run.test_steps) && !S::TEST_COLUMNS.is_empty();
        if !test_due && !due(run.log_steps) {
            return Ok(());
        }
        let means = state.means::<S>(spec.name)?;
        let tests = match test_due {
            true => state.test(spec, stage)?,
            false => None,
        };
        let rate = spec.training.rate_at(done - 1, self.total);
        self.metrics.append(done, rate, &means, tests.as_deref())?;
        let mut losses = format!("loss {:.5}", means.first().unwrap_or(&f32::NAN));
        for (column, value) in S::TEST_COLUMNS.iter().zip(tests.iter().flatten()) {
            losses.push_str(&format!("  {column} {value:.5}"));
        }
        if let Some(best) = state.best.filter(|_| tests.is_some()) {
            losses.push_str(&format!("  (best {:.5} at {})", best.value, best.step));
        }
        self.progress.show(done, &losses, self.output);
        Ok(())
    }
}
