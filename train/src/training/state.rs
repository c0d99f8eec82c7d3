//! What a running stage holds, and how it gets into checkpoints and back.

use std::path::{Path, PathBuf};

use burn_tensor::Tensor as Device;

use super::{
    TrainError, TrainingConfig,
    adam::{Adam, clip},
    keep::{BEST_FILE, BEST_STEP, BEST_VALUE, CHECKPOINT_FILE, FINISHED, SETTINGS},
    runner::{Losses, Plan, WEIGHT, Work},
    saved::{Saved, remove_partial},
};
use crate::{
    Tensor,
    nn::{Parameters, Trainable, values},
};

const FIRST_MOMENT: &str = "adam.first.";
const SECOND_MOMENT: &str = "adam.second.";
const METERS: &str = "meters";
const STEP: &str = "step";

/// The lowest test loss so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Best {
    pub(super) value: f32,
    pub(super) step: u64,
}

pub(super) struct State<A: Trainable> {
    parameters: Parameters<A::InnerBackend>,
    /// How fast each of them learns, in units of the stage's rate.
    rate_factors: Vec<f64>,
    adam: Adam<A::InnerBackend>,
    pub(super) step: u64,
    pub(super) best: Option<Best>,
    /// Sums of the metrics since the last line.
    sums: Vec<Device<A::InnerBackend, 1>>,
    summed: f32,
    folder: PathBuf,
}

impl<A: Trainable> State<A> {
    /// From the checkpoint in `folder`, or from the plan's weights.
    pub(super) fn start<W: Work<A>>(
        plan: &Plan<'_>,
        work: &mut W,
        device: &A::Device,
        folder: &Path,
    ) -> Result<Self, TrainError> {
        remove_partial(folder).map_err(TrainError::file(folder))?;
        let parameters =
            Parameters::from_store(&plan.store, device).in_precision(plan.run.precision);
        let mut state = Self {
            adam: Adam::new(parameters.tensors(), plan.training.betas),
            parameters,
            rate_factors: plan
                .store
                .entries()
                .iter()
                .map(|(name, _)| work.rate_factor(name))
                .collect(),
            step: 0,
            best: None,
            sums: W::COLUMNS
                .iter()
                .map(|_| Device::zeros([1], device))
                .collect(),
            summed: 0.0,
            folder: folder.to_owned(),
        };
        let path = folder.join(CHECKPOINT_FILE);
        if let Some(saved) = Saved::read(&path)? {
            let failed = |message| TrainError::State { path, message };
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
        let settings = saved.fact(SETTINGS);
        if settings != plan.settings {
            return Err(other_settings(settings));
        }
        self.step = parse(saved, STEP)?;
        if !saved.fact(BEST_STEP).is_empty() {
            self.best = Some(Best {
                value: parse(saved, BEST_VALUE)?,
                step: parse(saved, BEST_STEP)?,
            });
        }
        let load = |prefix: &str| -> Result<Parameters<A::InnerBackend>, String> {
            let parameters = Parameters::from_store(&saved.fill(prefix, &plan.store)?, device);
            Ok(parameters.in_precision(plan.run.precision))
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

    /// One step downhill.
    pub(super) fn advance<W: Work<A>>(
        &mut self,
        training: &TrainingConfig,
        work: &mut W,
        rate: f64,
    ) {
        let tracked: Parameters<A> = self.parameters.tracked();
        let Losses { loss, metrics } = work.step(&tracked, self.step);
        let mut gradients = loss.backward();
        let tensors = tracked.tensors().iter().zip(&self.rate_factors);
        let gradient = |(tensor, factor): (&Device<A, 1>, &f64)| {
            let gradient = tensor.grad_remove(&mut gradients);
            gradient.filter(|_| *factor > 0.0)
        };
        let mut gradients: Vec<_> = tensors.map(gradient).collect();
        // The last copies but our own: what nobody else has is changed in its place.
        drop(tracked);
        clip(&mut gradients, training.clip);
        let earlier = work.earlier_updates(self.step);
        let rates: Vec<f64> = self
            .rate_factors
            .iter()
            .map(|factor| rate * factor)
            .collect();
        self.adam
            .step(self.parameters.tensors_mut(), gradients, &rates, earlier);
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
    pub(super) fn means<W: Work<A>>(
        &mut self,
        stage: &'static str,
    ) -> Result<Vec<f32>, TrainError> {
        let means: Vec<f32> = self
            .read_sums()
            .iter()
            .map(|sum| sum / self.summed)
            .collect();
        self.check(W::COLUMNS, &means, stage)?;
        self.summed = 0.0;
        for sum in &mut self.sums {
            *sum = sum.zeros_like();
        }
        Ok(means)
    }

    /// Measures on the test split, and keeps these weights if they are the best so far.
    pub(super) fn test<W: Work<A>>(
        &mut self,
        plan: &Plan<'_>,
        work: &W,
    ) -> Result<Option<Vec<f32>>, TrainError> {
        let Some(tests) = work.test(&self.parameters) else {
            return Ok(None);
        };
        self.check(W::TEST_COLUMNS, &tests, plan.name)?;
        if let Some(&value) = tests.first()
            && self.best.is_none_or(|best| value < best.value)
        {
            let step = self.step;
            self.best = Some(Best { value, step });
            let saved = self.weights(plan, work)?;
            saved.write(&self.folder.join(BEST_FILE))?;
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
            Err(TrainError::NotFinite {
                stage,
                column,
                value,
                step: self.step,
            })
        })
    }

    /// What later stages need.
    fn weights<W: Work<A>>(&self, plan: &Plan<'_>, work: &W) -> Result<Saved, TrainError> {
        let mut saved = Saved::default();
        saved.put(WEIGHT, &self.parameters.to_store(&plan.store));
        work.save(&mut saved);
        self.check_tensors(&saved, plan.name)?;
        let facts = [
            ("stage", plan.name.to_owned()),
            (STEP, self.step.to_string()),
            (SETTINGS, plan.settings.clone()),
        ];
        saved.facts = facts.map(|(name, value)| (name.to_owned(), value)).into();
        if let Some(best) = self.best {
            let facts = [
                (BEST_VALUE, best.value.to_string()),
                (BEST_STEP, best.step.to_string()),
            ];
            let facts = facts.map(|(name, value)| (name.to_owned(), value));
            saved.facts.extend(facts);
        }
        Ok(saved)
    }

    /// Writes the checkpoint of a run of `total` steps.
    pub(super) fn save<W: Work<A>>(
        &self,
        plan: &Plan<'_>,
        work: &W,
        total: u64,
    ) -> Result<(), TrainError> {
        let mut meters = vec![self.summed];
        meters.extend(self.read_sums());
        self.check(W::COLUMNS, meters.get(1..).unwrap_or_default(), plan.name)?;
        let mut saved = self.weights(plan, work)?;
        let moments = [
            (FIRST_MOMENT, &self.adam.first),
            (SECOND_MOMENT, &self.adam.second),
        ];
        for (prefix, tensors) in moments {
            let values = tensors.iter().map(values).collect();
            saved.put(prefix, &plan.store.with_values(values));
        }
        let meters = Tensor::from_fn(vec![meters.len()], |place| meters[place]);
        saved.tensors.insert(METERS.into(), meters);
        self.check_tensors(&saved, plan.name)?;
        let finished = (self.step >= total).to_string();
        saved.facts.insert(FINISHED.into(), finished);
        saved.write(&self.folder.join(CHECKPOINT_FILE))
    }

    /// A run that went wrong must not replace the checkpoint from before: a derivative can spoil
    /// the weights in the very step whose loss was still a number.
    fn check_tensors(&self, saved: &Saved, stage: &'static str) -> Result<(), TrainError> {
        let mut values = saved.tensors.values().flat_map(Tensor::data);
        let wrong = values.find(|value| !value.is_finite());
        wrong.map_or(Ok(()), |&value| {
            Err(TrainError::NotFinite {
                stage,
                column: "state",
                value,
                step: self.step,
            })
        })
    }
}

/// Why a checkpoint is refused that was made with `found`.
pub(super) fn other_settings(found: &str) -> String {
    format!("made with other settings or data ({found}): use another run.folder, or delete it")
}

fn parse<T: std::str::FromStr>(saved: &Saved, name: &str) -> Result<T, String> {
    let text = saved.fact(name);
    text.parse()
        .map_err(|_| format!("`{text}` is no value of `{name}`"))
}
