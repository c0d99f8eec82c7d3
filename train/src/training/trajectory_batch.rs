//! A batch of windows of generated pieces, and its losses (paper Eq. 7-11).

use burn_tensor::{Int, Tensor, activation::log_softmax};

use super::{
    rollout::{Rollout, RolloutPlan},
    sampling::{Window, inputs},
};
use crate::nn::{self, Logits, Trainable, numbers};

/// A batch of windows of `block` codes: as many states, and one move fewer between them. (The 30th
/// code of ARCHITECTURE section 6 is only the target of a move that no reward is known for.)
pub(super) struct TrajectoryBatch<A: Trainable> {
    pub(super) music: Tensor<A::InnerBackend, 3>,
    /// The codes so far in each state, `[windows, block]`.
    pub(super) states: [Tensor<A::InnerBackend, 2, Int>; 2],
    /// The codes that were drawn in each state but the last, `[windows, block - 1]`.
    taken: [Tensor<A, 2, Int>; 2],
    /// Of those codes.
    rewards: Tensor<A, 2>,
    /// Weight of each move in means over the batch; together 1.
    shares: Tensor<A, 2>,
}

impl<A: Trainable> TrajectoryBatch<A> {
    /// Cuts the windows out of the pieces. The reward of a move is that of the code `lead` before
    /// it, so that the effect of a code on the frames before it counts for it.
    pub(super) fn new(
        plan: &RolloutPlan,
        rollout: &Rollout,
        windows: &[(usize, usize)],
        lead: usize,
        device: &A::Device,
    ) -> Self {
        let (block, moves) = (plan.block, plan.block - 1);
        let excerpts: Vec<Window<'_>> = windows
            .iter()
            .map(|&(piece, first)| Window {
                music: plan.music(rollout.episodes[piece].excerpt),
                codes: &rollout.episodes[piece].codes,
                first,
            })
            .collect();
        let rewards = windows.iter().flat_map(|&(piece, first)| {
            let rewards = &rollout.episodes[piece].rewards;
            let of = move |code: usize| rewards[code.saturating_sub(lead)][0];
            (first + 1..=first + moves).map(of)
        });
        let rewards: Vec<f32> = rewards.collect();
        // Windows overlap: all steps of a piece's first count, of the others the last alone.
        let counts = windows.iter().flat_map(|&(_, first)| {
            (0..moves).map(move |step| f32::from(u8::from(first == 0 || step + 1 == moves)))
        });
        Self::of(&excerpts, block, rewards, counts.collect(), device)
    }

    /// Takes windows whose every move counts, whatever it was rewarded with.
    pub(super) fn imitated(windows: &[Window<'_>], block: usize, device: &A::Device) -> Self {
        let moves = windows.len() * (block - 1);
        Self::of(windows, block, vec![0.0; moves], vec![1.0; moves], device)
    }

    /// Takes windows with reward and weight of each move.
    fn of(
        excerpts: &[Window<'_>],
        block: usize,
        rewards: Vec<f32>,
        counts: Vec<f32>,
        device: &A::Device,
    ) -> Self {
        let moves = block - 1;
        let (music, states) = inputs(excerpts, block, device);
        let shape = [excerpts.len(), moves];
        let taken = [0, 1].map(|half| {
            let codes =
                excerpts.iter().flat_map(|window| &window.codes[half][window.first + 1..][..moves]);
            nn::codes(codes.copied(), shape, device)
        });
        let total: f32 = counts.iter().sum();
        let shares = counts.iter().map(|count| count / total).collect::<Vec<f32>>();
        Self {
            music,
            states,
            taken,
            rewards: numbers(rewards, shape, device),
            shares: numbers(shares, shape, device),
        }
    }

    /// Returns the cross-entropy of the codes taken and the entropy of the policy, upper + lower of
    /// each move.
    pub(super) fn policy(&self, logits: Logits<A>) -> (Tensor<A, 2>, Tensor<A, 2>) {
        let [windows, moves] = self.rewards.dims();
        let half = |logits: Tensor<A, 3>, taken: &Tensor<A, 2, Int>| {
            let scores = log_softmax(logits.narrow(1, 0, moves), 2);
            let cross_entropy = scores.clone().gather(2, taken.clone().unsqueeze_dim::<3>(2));
            let entropy = (scores.clone().exp() * scores).sum_dim(2);
            [cross_entropy, entropy].map(|sum| sum.neg().reshape([windows, moves]))
        };
        let [upper, upper_entropy] = half(logits.upper, &self.taken[0]);
        let [lower, lower_entropy] = half(logits.lower, &self.taken[1]);
        (upper + lower, upper_entropy + lower_entropy)
    }

    /// Returns `KL(policy || reference)` of each move in nats, upper + lower.
    pub(super) fn divergence(
        &self,
        policy: Logits<A>,
        reference: Logits<A::InnerBackend>,
    ) -> Tensor<A, 2> {
        let [windows, moves] = self.rewards.dims();
        let half = |policy: Tensor<A, 3>, reference: Tensor<A::InnerBackend, 3>| {
            let scores = log_softmax(policy.narrow(1, 0, moves), 2);
            let wanted = log_softmax(reference.narrow(1, 0, moves), 2);
            let apart = scores.clone() - Tensor::from_inner(wanted);
            (scores.exp() * apart).sum_dim(2).reshape([windows, moves])
        };
        half(policy.upper, reference.upper) + half(policy.lower, reference.lower)
    }

    /// `TD = r + discount * v[1:] - v[:-1]` (Eq. 9).
    pub(super) fn td_error(&self, values: Tensor<A, 2>, discount: f64) -> Tensor<A, 2> {
        let [_, moves] = self.rewards.dims();
        let next = values.clone().narrow(1, 1, moves);
        self.rewards.clone() + next.mul_scalar(discount) - values.narrow(1, 0, moves)
    }

    /// Returns the generalised advantage (Schulman et al. 2016): the sum of TD errors to the
    /// window's end, weighted by the powers of `decay` (discount times λ). With 0 they stay
    /// as they are.
    pub(super) fn generalised_advantage(&self, td_error: Tensor<A, 2>, decay: f64) -> Tensor<A, 2> {
        if decay == 0.0 {
            return td_error;
        }
        let [_, moves] = self.rewards.dims();
        let counts = (0..moves * moves).map(|flat| {
            let (later, earlier) = (flat / moves, flat % moves);
            match later.checked_sub(earlier) {
                Some(distance) => decay.powi(distance as i32) as f32,
                None => 0.0,
            }
        });
        let device = td_error.device();
        td_error.matmul(numbers(counts.collect(), [moves, moves], &device))
    }

    /// Scales values to mean 0 and variance 1 over the batch, so that half of the moves get
    /// likelier and half less.
    pub(super) fn standardised(&self, values: Tensor<A, 2>) -> Tensor<A, 2> {
        let mean = self.mean(values.clone()).unsqueeze_dim(0);
        let centred = values - mean;
        let variance = self.mean(centred.clone().square()).unsqueeze_dim(0);
        centred / variance.sqrt().add_scalar(1e-6)
    }

    pub(super) fn mean(&self, values: Tensor<A, 2>) -> Tensor<A, 1> {
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
    fn batch(windows: &[(usize, usize)], lead: usize) -> TrajectoryBatch<Cpu> {
        let plan = RolloutPlan {
            songs: vec![Song {
                rows: Array2::from_shape_fn((7, 1), |(row, _)| row as f32),
                beats: Vec::new(),
                style: None,
            }],
            pieces: 1,
            codes: 6,
            takes: 1,
            continued: 0.0,
            block: BLOCK,
            seed: 1,
        };
        let episode = Episode {
            excerpt: plan.excerpts(0)[0],
            codes: [(0..6).collect(), (10..16).collect()],
            rewards: (0..6).map(|k| [(k * k) as f32, 0.0, 0.0]).collect(),
        };
        let rollout = plan.arranged(0, [0.0; 3], vec![episode]);
        TrajectoryBatch::new(&plan, &rollout, windows, lead, &FlexDevice)
    }

    #[test]
    fn windows_are_cut_as_defined() {
        let batch = batch(&[(0, 0), (0, 2)], 0);
        let music = values(&batch.music);
        assert_eq!(music, [1.0, 2.0, 3.0, 4.0, 3.0, 4.0, 5.0, 6.0]);
        let codes =
            |codes: &Tensor<Flex, 2, Int>| codes.to_data().iter::<i32>().collect::<Vec<_>>();
        assert_eq!(codes(&batch.states[0]), [0, 1, 2, 3, 2, 3, 4, 5]);
        let taken = batch.taken[1].clone().inner();
        assert_eq!(codes(&taken), [11, 12, 13, 13, 14, 15]);
        assert_eq!(values(&batch.rewards), [1.0, 4.0, 9.0, 9.0, 16.0, 25.0]);
        // All of the first window, the last move of the other.
        assert_eq!(values(&batch.shares), [0.25, 0.25, 0.25, 0.0, 0.0, 0.25]);
    }

    #[test]
    fn td_error_and_cross_entropy_are_as_defined() {
        let batch = batch(&[(0, 0)], 0);
        let state_values = Tensor::from_floats([[1.0, -2.0, 0.5, 3.0]], &FlexDevice);
        let td_error = batch.td_error(state_values, 0.5);
        let wanted = [1.0 - 1.0 - 1.0, 4.0 + 0.25 + 2.0, 9.0 + 1.5 - 0.5];
        assert_eq!(values(&td_error), wanted);
        assert_eq!(values(&batch.mean(td_error)), [(wanted.iter().sum::<f32>()) / 3.0]);

        let table = |shift: f32| {
            let scores = (0..BLOCK * 20).map(|flat| (flat as f32 * 0.37 + shift).sin());
            scores.collect::<Vec<f32>>()
        };
        let (upper, lower) = (table(0.0), table(1.0));
        let device = |table: &[f32]| numbers(table.to_vec(), [1, BLOCK, 20], &FlexDevice);
        let (cross_entropy, entropy) =
            batch.policy(Logits { upper: device(&upper), lower: device(&lower) });
        for step in 0..BLOCK - 1 {
            let half = |table: &[f32], taken: usize| {
                let row = &table[step * 20..][..20];
                let total: f32 = row.iter().map(|score| score.exp()).sum();
                let entropy: f32 = row.iter().map(|x| -(x.exp() / total) * (x - total.ln())).sum();
                (total.ln() - row[taken], entropy)
            };
            let (upper, lower) = (half(&upper, step + 1), half(&lower, 11 + step));
            let close = |found: f32, wanted: f32| assert!((found - wanted).abs() < 1e-5);
            close(values(&cross_entropy)[step], upper.0 + lower.0);
            close(values(&entropy)[step], upper.1 + lower.1);
        }
    }

    #[test]
    fn a_divergence_is_none_from_itself_and_else_as_defined() {
        let batch = batch(&[(0, 0)], 0);
        let table = |shift: f32| -> Vec<f32> {
            (0..BLOCK * 20).map(|flat| (flat as f32 * 0.37 + shift).sin()).collect()
        };
        fn device<B: burn_tensor::backend::Backend<Device = FlexDevice>>(
            table: &[f32],
        ) -> Tensor<B, 3> {
            numbers(table.to_vec(), [1, BLOCK, 20], &FlexDevice)
        }
        let divergence = |policy: [f32; 2], reference: [f32; 2]| {
            let policy = policy.map(|shift| device::<Cpu>(&table(shift)));
            let reference = reference.map(|shift| device::<Flex>(&table(shift)));
            let [upper, lower] = policy;
            let policy = Logits { upper, lower };
            let [upper, lower] = reference;
            values(&batch.divergence(policy, Logits { upper, lower }))
        };
        let none = divergence([0.3, 1.0], [0.3, 1.0]);
        assert!(none.iter().all(|nats| nats.abs() < 1e-6), "{none:?}");
        let found = divergence([0.3, 1.0], [0.8, -2.0]);
        for (step, found) in found.into_iter().enumerate() {
            let half = |policy: f32, reference: f32| -> f32 {
                let shares = |shift: f32| -> Vec<f32> {
                    let row = table(shift)[step * 20..][..20].to_vec();
                    let total: f32 = row.iter().map(|score| score.exp()).sum();
                    row.iter().map(|score| score.exp() / total).collect()
                };
                let pairs = shares(policy).into_iter().zip(shares(reference));
                pairs.map(|(p, q)| p * (p / q).ln()).sum()
            };
            let wanted = half(0.3, 0.8) + half(1.0, -2.0);
            assert!((found - wanted).abs() < 1e-5, "{found} {wanted}");
        }
    }

    #[test]
    fn a_code_may_be_paid_for_the_one_before_it() {
        let batch = batch(&[(0, 0), (0, 2)], 1);
        assert_eq!(values(&batch.rewards), [0.0, 1.0, 4.0, 4.0, 9.0, 16.0]);
    }

    #[test]
    fn later_td_errors_count_by_their_distance() {
        let batch = batch(&[(0, 0)], 0);
        let td_error = || Tensor::<Cpu, 2>::from_floats([[1.0, -2.0, 4.0]], &FlexDevice);
        assert_eq!(values(&batch.generalised_advantage(td_error(), 0.0)), [1.0, -2.0, 4.0]);
        assert_eq!(values(&batch.generalised_advantage(td_error(), 0.5)), [1.0, 0.0, 4.0]);
    }

    #[test]
    fn standardised_values_have_the_mean_and_variance_of_what_counts() {
        // Of the second window only the last move counts.
        let batch = batch(&[(0, 0), (0, 2)], 0);
        let table =
            Tensor::<Cpu, 2>::from_floats([[1.0, 2.0, 3.0], [50.0, 60.0, 6.0]], &FlexDevice);
        let found = values(&batch.standardised(table));
        for (value, wanted) in [(0, 1.0), (1, 2.0), (2, 3.0), (5, 6.0)] {
            assert!((found[value] - (wanted - 3.0) / 3.5_f32.sqrt()).abs() < 1e-5);
        }
    }
}
