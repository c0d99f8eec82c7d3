//! The state of a running stage, and its way into checkpoints and back.

use std::path::{Path, PathBuf};

use burn_tensor::Tensor;

use super::{
    adam::{Adam, clip},
    checkpoint::Checkpoint,
    config::TrainingConfig,
    error::TrainError,
    files::remove_partial,
    kept::{
        BEST_FILE, BEST_STEP, BEST_VALUE, CHECKPOINT_FILE, STEP, WEIGHT, WINDOWS, has_all_steps,
        parsed,
    },
    trainable::{Losses, StageSpec, TrainableStage},
};
use crate::{
    HostTensor,
    nn::{Parameters, Trainable, values},
};

const FIRST_MOMENT: &str = "adam.first.";
const SECOND_MOMENT: &str = "adam.second.";
const UPDATES: &str = "adam.updates";
const METERS: &str = "meters";

/// The lowest test loss so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Best {
    pub(super) value: f32,
    pub(super) step: u64,
}

/// Weights, optimiser, metrics and progress of a running stage.
pub(super) struct State<A: Trainable> {
    parameters: Parameters<A::InnerBackend>,
    /// Learning rate of each of them, in units of the stage's rate.
    rate_factors: Vec<f64>,
    adam: Adam<A::InnerBackend>,
    pub(super) step: u64,
    pub(super) best: Option<Best>,
    /// Sums of the metrics since the last line.
    sums: Vec<Tensor<A::InnerBackend, 1>>,
    summed: f32,
    folder: PathBuf,
}

impl<A: Trainable> State<A> {
    /// Starts from the checkpoint in `folder`, or from the first weights of `spec`.
    pub(super) fn start<S: TrainableStage<A>>(
        spec: &StageSpec<'_>,
        stage: &mut S,
        device: &A::Device,
        folder: &Path,
    ) -> Result<Self, TrainError> {
        remove_partial(folder).map_err(TrainError::file(folder))?;
        let parameters = Parameters::from_store(&spec.store, device);
        let names = spec.store.entries().iter().map(|(name, _)| name);
        let mut state = Self {
            adam: Adam::new(parameters.tensors(), spec.training.betas),
            parameters,
            rate_factors: names.map(|name| stage.rate_factor(name)).collect(),
            step: 0,
            best: None,
            sums: S::COLUMNS.iter().map(|_| Tensor::zeros([1], device)).collect(),
            summed: 0.0,
            folder: folder.to_owned(),
        };
        let path = folder.join(CHECKPOINT_FILE);
        if let Some(checkpoint) = Checkpoint::read(&path)? {
            let restored = state.restore(spec, stage, &checkpoint, device);
            restored.map_err(TrainError::state(&path))?;
        }
        Ok(state)
    }

    fn restore<S: TrainableStage<A>>(
        &mut self,
        spec: &StageSpec<'_>,
        stage: &mut S,
        checkpoint: &Checkpoint,
        device: &A::Device,
    ) -> Result<(), String> {
        let facts = &checkpoint.facts;
        spec.identity.check(facts)?;
        has_all_steps(facts, spec.training)?;
        self.step = parsed(facts, STEP)?;
        if facts.contains_key(BEST_STEP) {
            self.best =
                Some(Best { value: parsed(facts, BEST_VALUE)?, step: parsed(facts, BEST_STEP)? });
        }
        let load = |prefix: &str| -> Result<Parameters<A::InnerBackend>, String> {
            let store = checkpoint.fill(prefix, &spec.store)?;
            Ok(Parameters::from_store(&store, device))
        };
        self.parameters = load(WEIGHT)?;
        self.adam.first = load(FIRST_MOMENT)?.tensors().to_vec();
        self.adam.second = load(SECOND_MOMENT)?.tensors().to_vec();
        let updates = checkpoint.tensor(UPDATES)?.data().iter();
        self.adam.updates = updates.map(|&count| count as u32).collect();
        let meters = checkpoint.tensor(METERS)?.data();
        let (summed, sums) = meters.split_first().ok_or("no meters")?;
        self.summed = *summed;
        for (sum, value) in self.sums.iter_mut().zip(sums) {
            *sum = Tensor::from_floats([*value], device);
        }
        stage.restore(checkpoint)
    }

    /// Takes one step downhill.
    pub(super) fn advance<S: TrainableStage<A>>(
        &mut self,
        training: &TrainingConfig,
        stage: &mut S,
        rate: f64,
    ) {
        let tracked: Parameters<A> = self.parameters.tracked();
        let Losses { loss, metrics } = stage.step(&tracked, self.step);
        let mut gradients = loss.backward();
        let tensors = tracked.tensors().iter().zip(&self.rate_factors);
        let gradient = |(tensor, factor): (&Tensor<A, 1>, &f64)| {
            let gradient = tensor.grad_remove(&mut gradients);
            gradient.filter(|_| *factor > 0.0)
        };
        let mut gradients: Vec<_> = tensors.map(gradient).collect();
        // The last other copies of the weights: without them Adam changes the tensors in place.
        drop(tracked);
        clip(&mut gradients, training.clip);
        let factors = self.rate_factors.iter();
        let rates: Vec<f64> = factors.map(|factor| rate * factor).collect();
        self.adam.step(self.parameters.tensors_mut(), gradients, &rates);
        for (sum, value) in self.sums.iter_mut().zip(metrics) {
            *sum = sum.clone() + value;
        }
        self.summed += 1.0;
        self.step += 1;
    }

    fn read_sums(&self) -> Vec<f32> {
        self.sums.iter().flat_map(values).collect()
    }

    /// Returns the means since the last line, and starts the next.
    pub(super) fn means<S: TrainableStage<A>>(
        &mut self,
        name: &'static str,
    ) -> Result<Vec<f32>, TrainError> {
        let sums = self.read_sums();
        let means: Vec<f32> = sums.iter().map(|sum| sum / self.summed).collect();
        self.check(S::COLUMNS, &means, name)?;
        self.summed = 0.0;
        for sum in &mut self.sums {
            *sum = sum.zeros_like();
        }
        Ok(means)
    }

    /// Measures on the test split, and keeps these weights if they are the best so far.
    pub(super) fn test<S: TrainableStage<A>>(
        &mut self,
        spec: &StageSpec<'_>,
        stage: &S,
    ) -> Result<Option<Vec<f32>>, TrainError> {
        let Some(tests) = stage.test(&self.parameters) else {
            return Ok(None);
        };
        self.check(S::TEST_COLUMNS, &tests, spec.name)?;
        if let Some(&value) = tests.first()
            && self.best.is_none_or(|best| value < best.value)
        {
            let step = self.step;
            self.best = Some(Best { value, step });
            let checkpoint = self.weights(spec, stage)?;
            checkpoint.write(&self.folder.join(BEST_FILE))?;
        }
        Ok(Some(tests))
    }

    fn check(
        &self,
        columns: &[&'static str],
        values: &[f32],
        stage: &'static str,
    ) -> Result<(), TrainError> {
        let mut values = columns.iter().zip(values);
        let wrong = values.find(|(_, value)| !value.is_finite());
        wrong.map_or(Ok(()), |(column, &value)| {
            Err(TrainError::NotFinite { stage, column, value, step: self.step })
        })
    }

    /// Returns what later stages need.
    fn weights<S: TrainableStage<A>>(
        &self,
        spec: &StageSpec<'_>,
        stage: &S,
    ) -> Result<Checkpoint, TrainError> {
        let mut checkpoint = Checkpoint::default();
        checkpoint.put_store(WEIGHT, &self.parameters.to_store(&spec.store));
        stage.save(&mut checkpoint);
        self.check_tensors(&checkpoint, spec.name)?;
        let mut put = |name: &str, value: String| checkpoint.facts.insert(name.into(), value);
        put("stage", spec.name.into());
        put(STEP, self.step.to_string());
        put(WINDOWS, spec.windows.to_string());
        if let Some(best) = self.best {
            put(BEST_VALUE, best.value.to_string());
            put(BEST_STEP, best.step.to_string());
        }
        spec.identity.put(&mut checkpoint.facts);
        Ok(checkpoint)
    }

    /// Writes the checkpoint.
    pub(super) fn save<S: TrainableStage<A>>(
        &self,
        spec: &StageSpec<'_>,
        stage: &S,
    ) -> Result<(), TrainError> {
        let mut meters = vec![self.summed];
        meters.extend(self.read_sums());
        self.check(S::COLUMNS, &meters[1..], spec.name)?;
        let mut checkpoint = self.weights(spec, stage)?;
        let moments = [(FIRST_MOMENT, &self.adam.first), (SECOND_MOMENT, &self.adam.second)];
        for (prefix, tensors) in moments {
            let values = tensors.iter().map(values).collect();
            checkpoint.put_store(prefix, &spec.store.with_values(values));
        }
        // Exact up to 2^24, where no correction is left.
        let updates: Vec<f32> = self.adam.updates.iter().map(|&count| count as f32).collect();
        checkpoint.put_vector(UPDATES, &updates);
        checkpoint.put_vector(METERS, &meters);
        self.check_tensors(&checkpoint, spec.name)?;
        checkpoint.write(&self.folder.join(CHECKPOINT_FILE))
    }

    /// Refuses values that are not finite: a run that went wrong must not replace the checkpoint
    /// from before. A derivative can spoil the weights in a step whose loss was still a number.
    fn check_tensors(
        &self,
        checkpoint: &Checkpoint,
        stage: &'static str,
    ) -> Result<(), TrainError> {
        let mut values = checkpoint.tensors.values().flat_map(HostTensor::data);
        let wrong = values.find(|value| !value.is_finite());
        wrong.map_or(Ok(()), |&value| self.check(&["state"], &[value], stage))
    }
}
