//! Parts that can be left out of the model, to see what they contribute (paper Table 2).

use serde::{Deserialize, Serialize};

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
    /// Returns the first part that is left out.
    pub(in crate::training) fn flag(self) -> Option<&'static str> {
        let flags = [
            ("whole_body", self.whole_body),
            ("root_in_pose", self.root_in_pose),
            ("separate_halves", self.separate_halves),
            ("continuous", self.continuous),
        ];
        flags.into_iter().find_map(|(name, set)| set.then_some(name))
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
}
