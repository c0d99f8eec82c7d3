//! Networks with parts left out (paper Table 2).

use super::{
    config::{AblationConfig, Config},
    error::TrainError,
};
use crate::{
    data::JOINTS,
    nn::{GptNet, Store},
    weights::{GptWeights, HALF_JOINTS},
};

impl AblationConfig {
    /// Refuses a command that only whole models have: the served graphs know no other form.
    pub(super) fn refuse(self, what: &'static str) -> Result<(), TrainError> {
        let refused = |flag| Err(TrainError::LeftOut { what, flag });
        self.flag().map_or(Ok(()), refused)
    }

    /// Plans the motion GPT without the parts that are left out.
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
    /// Returns the motion columns that each half of the VQ-VAE takes and gives; `None` is a column
    /// of zeros. With `whole_body` both halves are the whole body.
    pub(super) fn pose_columns(&self) -> [Vec<Option<usize>>; 2] {
        let AblationConfig { whole_body, root_in_pose, .. } = self.ablation;
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
    use bailando::motion::MotionFrame;

    use super::*;

    fn config(flags: &str) -> Config {
        Config::parse(&format!("[ablation]\n{flags}")).unwrap()
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
