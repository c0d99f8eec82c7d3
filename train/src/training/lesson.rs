//! A batch of windows of generated pieces, and what they teach (paper Eq. 7-11).

use burn_tensor::{Int, Tensor as Device, TensorData, activation::log_softmax};

use super::{
    rollout::{Repertoire, Rollout},
    sampling::{Window, inputs},
};
use crate::nn::{Logits, Trainable};

/// A batch of windows of `block` codes: as many states, and one move fewer between them. (The 30th
/// code of ARCHITECTURE section 6 is only the target of a move that no reward is known for.)
pub(super) struct Lesson<A: Trainable> {
    pub(super) music: Device<A::InnerBackend, 3>,
    /// The codes so far in each state, `[windows, block]`.
    pub(super) states: [Device<A::InnerBackend, 2, Int>; 2],
    /// The codes that were drawn in each state but the last, `[windows, block - 1]`.
    taken: [Device<A, 2, Int>; 2],
    /// Of those codes.
    rewards: Device<A, 2>,
    /// What each move counts in means over the batch; together 1.
    shares: Device<A, 2>,
}

impl<A: Trainable> Lesson<A> {
    /// The windows' parts of the pieces.
    pub(super) fn new(
        repertoire: &Repertoire,
        rollout: &Rollout,
        windows: &[(usize, usize)],
        device: &A::Device,
    ) -> Self {
        let (block, moves) = (repertoire.block, repertoire.block - 1);
        let excerpts: Vec<Window<'_>> = windows
            .iter()
            .map(|&(piece, first)| Window {
                music: repertoire.music(rollout.episodes[piece].excerpt),
                codes: &rollout.episodes[piece].codes,
                first,
            })
            .collect();
        let (music, states) = inputs(&excerpts, block, device);
        let shape = [windows.len(), moves];
        let taken = [0, 1].map(|half| {
            let codes = excerpts
                .iter()
                .flat_map(|window| &window.codes[half][window.first + 1..][..moves]);
            let codes: Vec<i32> = codes.copied().collect();
            Device::from_data(TensorData::new(codes, shape), device)
        });
        let rewards = windows.iter().flat_map(|&(piece, first)| {
            let rewards = &rollout.episodes[piece].rewards[first + 1..][..moves];
            rewards.iter().map(|[total, ..]| *total)
        });
        let rewards: Vec<f32> = rewards.collect();
        // Windows overlap: all steps of a piece's first count, of the others the last alone.
        let counts = windows.iter().flat_map(|&(_, first)| {
            (0..moves).map(move |step| f32::from(u8::from(first == 0 || step + 1 == moves)))
        });
        let counts: Vec<f32> = counts.collect();
        let total: f32 = counts.iter().sum();
        let shares = counts
            .iter()
            .map(|count| count / total)
            .collect::<Vec<f32>>();
        Self {
            music,
            states,
            taken,
            rewards: Device::from_data(TensorData::new(rewards, shape), device),
            shares: Device::from_data(TensorData::new(shares, shape), device),
        }
    }

    /// Cross-entropy of the codes taken, and entropy of the policy; upper + lower of each move.
    pub(super) fn policy(&self, logits: Logits<A>) -> (Device<A, 2>, Device<A, 2>) {
        let [windows, moves] = self.rewards.dims();
        let half = |logits: Device<A, 3>, taken: &Device<A, 2, Int>| {
            let scores = log_softmax(logits.narrow(1, 0, moves), 2);
            let surprise = scores
                .clone()
                .gather(2, taken.clone().unsqueeze_dim::<3>(2));
            let entropy = (scores.clone().exp() * scores).sum_dim(2);
            [surprise, entropy].map(|sum| sum.neg().reshape([windows, moves]))
        };
        let [upper, upper_entropy] = half(logits.upper, &self.taken[0]);
        let [lower, lower_entropy] = half(logits.lower, &self.taken[1]);
        (upper + lower, upper_entropy + lower_entropy)
    }

    /// `TD = r + discount * v[1:] - v[:-1]` (Eq. 9).
    pub(super) fn surprise(&self, values: Device<A, 2>, discount: f64) -> Device<A, 2> {
        let [_, moves] = self.rewards.dims();
        let next = values.clone().narrow(1, 1, moves);
        self.rewards.clone() + next.mul_scalar(discount) - values.narrow(1, 0, moves)
    }

    pub(super) fn mean(&self, values: Device<A, 2>) -> Device<A, 1> {
        (values * self.shares.clone()).sum()
    }
}

#[cfg(test)]
mod tests {
    use burn_autodiff::Autodiff;
    use burn_flex::{Flex, FlexDevice};
    use ndarray::Array2;

    use super::*;
    use crate::{
        nn::values,
        training::{Song, rollout::Episode},
    };

    type Cpu = Autodiff<Flex>;
    const BLOCK: usize = 4;

    /// One piece of 6 codes: upper `k`, lower `10 + k`, reward `k * k`, music row `k` is `[k]`.
    fn lesson(windows: &[(usize, usize)]) -> Lesson<Cpu> {
        let repertoire = Repertoire {
            songs: vec![Song {
                rows: Array2::from_shape_fn((7, 1), |(row, _)| row as f32),
                beats: Vec::new(),
            }],
            pieces: 1,
            codes: 6,
            block: BLOCK,
            seed: 1,
        };
        let episode = Episode {
            excerpt: repertoire.excerpts(0)[0],
            codes: [(0..6).collect(), (10..16).collect()],
            rewards: (0..6).map(|k| [(k * k) as f32, 0.0, 0.0]).collect(),
        };
        let rollout = repertoire.arranged(0, vec![episode]);
        Lesson::new(&repertoire, &rollout, windows, &FlexDevice)
    }

    #[test]
    fn windows_are_cut_as_defined() {
        let lesson = lesson(&[(0, 0), (0, 2)]);
        let music = values(&lesson.music);
        assert_eq!(music, [1.0, 2.0, 3.0, 4.0, 3.0, 4.0, 5.0, 6.0]);
        let codes =
            |codes: &Device<Flex, 2, Int>| codes.to_data().iter::<i32>().collect::<Vec<_>>();
        assert_eq!(codes(&lesson.states[0]), [0, 1, 2, 3, 2, 3, 4, 5]);
        let taken = lesson.taken[1].clone().inner();
        assert_eq!(codes(&taken), [11, 12, 13, 13, 14, 15]);
        assert_eq!(values(&lesson.rewards), [1.0, 4.0, 9.0, 9.0, 16.0, 25.0]);
        // All of the first window, the last move of the other.
        assert_eq!(values(&lesson.shares), [0.25, 0.25, 0.25, 0.0, 0.0, 0.25]);
    }

    #[test]
    fn surprise_and_cross_entropy_are_as_defined() {
        let lesson = lesson(&[(0, 0)]);
        let state_values = Device::from_floats([[1.0, -2.0, 0.5, 3.0]], &FlexDevice);
        let surprise = lesson.surprise(state_values, 0.5);
        let wanted = [1.0 - 1.0 - 1.0, 4.0 + 0.25 + 2.0, 9.0 + 1.5 - 0.5];
        assert_eq!(values(&surprise), wanted);
        assert_eq!(
            values(&lesson.mean(surprise)),
            [(wanted.iter().sum::<f32>()) / 3.0]
        );

        let table = |shift: f32| {
            let scores = (0..BLOCK * 20).map(|flat| (flat as f32 * 0.37 + shift).sin());
            scores.collect::<Vec<f32>>()
        };
        let (upper, lower) = (table(0.0), table(1.0));
        let device = |table: &[f32]| {
            Device::from_data(TensorData::new(table.to_vec(), [1, BLOCK, 20]), &FlexDevice)
        };
        let (cross_entropy, entropy) = lesson.policy(Logits {
            upper: device(&upper),
            lower: device(&lower),
        });
        for step in 0..BLOCK - 1 {
            let half = |table: &[f32], taken: usize| {
                let row = &table[step * 20..][..20];
                let total: f32 = row.iter().map(|score| score.exp()).sum();
                let entropy: f32 = row
                    .iter()
                    .map(|x| -(x.exp() / total) * (x - total.ln()))
                    .sum();
                (total.ln() - row[taken], entropy)
            };
            let (upper, lower) = (half(&upper, step + 1), half(&lower, 11 + step));
            let close = |found: f32, wanted: f32| assert!((found - wanted).abs() < 1e-5);
            close(values(&cross_entropy)[step], upper.0 + lower.0);
            close(values(&entropy)[step], upper.1 + lower.1);
        }
    }
}
