//! What can be left out of the model, to see what it is good for (paper Table 2).

use serde::{Deserialize, Serialize};

use super::{Config, Stage, TrainError};
use crate::{
    data::JOINTS,
    nn::{GptNet, Store},
    weights::{GptWeights, HALF_JOINTS},
};

/// Parts that are left out; `train/presets/paper.toml` explains every field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the commented preset is the documentation")]
pub struct AblationConfig {
    pub whole_body: bool,
    pub root_in_pose: bool,
    pub separate_halves: bool,
    pub continuous: bool,
}

impl AblationConfig {
    fn flags(self) -> impl Iterator<Item = &'static str> {
        let flags = [
            ("whole_body", self.whole_body),
            ("root_in_pose", self.root_in_pose),
            ("separate_halves", self.separate_halves),
            ("continuous", self.continuous),
        ];
        flags
            .into_iter()
            .filter_map(|(name, set)| set.then_some(name))
    }

    pub(super) fn check(self, rewards: bool) -> Result<(), String> {
        if self.whole_body && self.separate_halves {
            return Err("whole_body leaves no halves to separate".into());
        }
        if self.continuous && rewards {
            return Err(
                "continuous has no probabilities to reward: set actor_critic.enabled = false"
                    .into(),
            );
        }
        Ok(())
    }

    /// What the result of a stage depends on; nothing where nothing is left out, so that it can
    /// stand before the settings of any checkpoint.
    pub(super) fn settings(self, stage: Stage) -> String {
        let attends = matches!(stage, Stage::Gpt | Stage::ActorCritic);
        let flags = self
            .flags()
            .filter(|&flag| flag != "separate_halves" || attends);
        flags.map(|flag| format!("ablation {flag} ")).collect()
    }

    /// Refuses what only whole models have: the graphs that are served know no other form.
    pub(super) fn refuse(self, what: &'static str) -> Result<(), TrainError> {
        self.flags()
            .next()
            .map_or(Ok(()), |flag| Err(TrainError::LeftOut { what, flag }))
    }

    /// The motion GPT with its parts left out.
    pub(super) fn network(self, weights: &GptWeights, store: &mut Store) -> GptNet {
        let mut net = GptNet::new(weights, store);
        if self.separate_halves {
            net = net.with_separate_halves();
        }
        if self.whole_body {
            net = net.with_one_code();
        }
        net
    }
}

impl Config {
    /// Whether a run has this stage.
    pub(super) fn has(&self, stage: Stage) -> bool {
        match stage {
            Stage::Velocity => !self.ablation.root_in_pose,
            Stage::ActorCritic => self.actor_critic.enabled,
            Stage::VqVae | Stage::Gpt => true,
        }
    }

    /// Motion columns that each half of the VQ-VAE takes and gives; `None` is a column of zeros.
    /// With `whole_body` both are all of the body.
    pub(super) fn pose_columns(&self) -> [Vec<Option<usize>>; 2] {
        let AblationConfig {
            whole_body,
            root_in_pose,
            ..
        } = self.ablation;
        let columns = |joints: &[usize], has_root: bool| -> Vec<Option<usize>> {
            let columns = joints.iter().flat_map(|&joint| {
                let known = joint != 0 || root_in_pose;
                (3 * joint..3 * joint + 3).map(move |column| known.then_some(column))
            });
            // The turn of the dancer's frame has no place among the joints.
            let root = self.data.root_columns().iter().skip(3);
            let root = root.filter(|_| root_in_pose && has_root);
            columns.chain(root.map(|&column| Some(column))).collect()
        };
        if whole_body {
            let joints: Vec<usize> = (0..JOINTS).collect();
            let all = columns(&joints, true);
            return [all.clone(), all];
        }
        let (upper, lower) = HALF_JOINTS;
        [columns(&upper, false), columns(&lower, true)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::{MotionFrame, keep::settings};

    fn config(flags: &str) -> Config {
        Config::parse(&format!("[ablation]\n{flags}")).unwrap()
    }

    #[test]
    fn checkpoints_of_whole_models_keep_their_settings() {
        let whole = settings(&config(""), Stage::VqVae).unwrap();
        assert!(whole.starts_with("seed 1 frame World mirror false phases 1 "));
        assert!(!whole.contains("ablation"), "{whole}");
        for flag in ["whole_body", "root_in_pose", "continuous"] {
            let text = format!("{flag} = true\n[actor_critic]\nenabled = false");
            let without = settings(&config(&text), Stage::VqVae).unwrap();
            assert_eq!(without, format!("ablation {flag} {whole}"));
        }
        // What it does not concern can be shared with the whole model.
        let separate = config("separate_halves = true");
        assert_eq!(settings(&separate, Stage::VqVae).unwrap(), whole);
        for stage in [Stage::Gpt, Stage::ActorCritic] {
            let flags = separate.ablation.settings(stage);
            assert_eq!(flags, "ablation separate_halves ");
        }
    }

    #[test]
    fn a_pose_has_the_columns_of_its_joints() {
        let mut config = config("");
        config.data.frame = MotionFrame::Dancer;
        let known = |config: &Config| {
            config
                .pose_columns()
                .map(|columns| columns.into_iter().flatten().collect::<Vec<usize>>())
        };
        let (upper, lower) = HALF_JOINTS;
        let of = |joints: &[usize]| -> Vec<usize> {
            let columns = joints.iter().flat_map(|joint| 3 * joint..3 * joint + 3);
            columns.collect()
        };
        assert_eq!(known(&config), [of(&upper), of(&lower[1..])]);
        let [_, lower_columns] = config.pose_columns();
        assert_eq!(lower_columns[..3], [None; 3], "zeros, as published");

        config.ablation.root_in_pose = true;
        let with_turn = [of(&lower), vec![72]].concat();
        assert_eq!(known(&config), [of(&upper), with_turn]);
        config.data.frame = MotionFrame::World;
        assert_eq!(known(&config), [of(&upper), of(&lower)]);

        config.ablation.whole_body = true;
        let all: Vec<usize> = (0..72).collect();
        assert_eq!(known(&config), [all.clone(), all.clone()]);
        config.ablation.root_in_pose = false;
        assert_eq!(known(&config), [all[3..].to_vec(), all[3..].to_vec()]);
    }
}
