//! The codebook of pose codes, learned by moving averages (ARCHITECTURE section 6).

use burn_tensor::{Distribution, Int, Tensor, backend::Backend};
use rand_chacha::{ChaCha8Rng, rand_core::Rng};

use super::host::{codes, numbers, values};
use crate::HostTensor;

/// Spread, times `1 / sqrt(channels)`, of the noise on repeated vectors.
const COPY_NOISE: f64 = 0.01;
/// The count of an entry that nothing was assigned to.
const NEVER_USED: f32 = 1e-6;

/// Entries, and the moving averages that they are the quotient of.
#[derive(Clone, Debug)]
pub struct Codebook<B: Backend> {
    entries: Tensor<B, 2>,
    sums: Tensor<B, 2>,
    counts: Tensor<B, 2>,
    device: B::Device,
}

impl<B: Backend> Codebook<B> {
    /// Takes entries `[codes, channels]`, each as if one vector had been assigned to it on average.
    #[must_use]
    pub fn new(entries: &HostTensor, device: &B::Device) -> Self {
        Self::fresh(loaded(entries, device))
    }

    /// Takes entries of which only the first `known` were learned: a vector of the first batch
    /// replaces each of the others, if any are ever replaced.
    #[must_use]
    pub fn begun(entries: &HostTensor, known: usize, device: &B::Device) -> Self {
        let counts = (0..entries.dim(0)).map(|row| if row < known { 1.0 } else { NEVER_USED });
        let counts = numbers(counts.collect(), [entries.dim(0), 1], device);
        let entries = loaded(entries, device);
        Self { sums: entries.clone() * counts.clone(), counts, entries, device: device.clone() }
    }

    fn fresh(entries: Tensor<B, 2>) -> Self {
        let [codes, _] = entries.dims();
        let device = entries.device();
        Self { sums: entries.clone(), counts: Tensor::ones([codes, 1], &device), entries, device }
    }

    /// Draws entries from `vectors` `[n, channels]`, the encoder's outputs for the first batch.
    #[must_use]
    pub fn from_batch(vectors: Tensor<B, 2>, codes: usize, random: &mut ChaCha8Rng) -> Self {
        Self::fresh(candidates(vectors, codes, random))
    }

    /// Returns entries, sums and counts, for a file.
    #[must_use]
    pub fn state(&self) -> [HostTensor; 3] {
        [&self.entries, &self.sums, &self.counts].map(|tensor| {
            let mut values = values(tensor).into_iter();
            HostTensor::from_fn(tensor.dims().to_vec(), |_| values.next().unwrap_or(f32::NAN))
        })
    }

    /// Restores what [`Codebook::state`] gave.
    #[must_use]
    pub fn from_state([entries, sums, counts]: [&HostTensor; 3], device: &B::Device) -> Self {
        Self {
            entries: loaded(entries, device),
            sums: loaded(sums, device),
            counts: loaded(counts, device),
            device: device.clone(),
        }
    }

    /// The entries, `[codes, channels]`.
    #[must_use]
    pub fn entries(&self) -> &Tensor<B, 2> {
        &self.entries
    }

    /// Number of entries.
    #[must_use]
    pub fn codes(&self) -> usize {
        let [codes, _] = self.entries.dims();
        codes
    }

    /// Finds the nearest entry of each of `vectors` `[n, channels]` by squared Euclidean distance.
    pub fn nearest(&self, vectors: Tensor<B, 2>) -> Tensor<B, 1, Int> {
        let [vector_count, _] = vectors.dims();
        // The vector's own square is the same for every entry.
        let squares = self.entries.clone().square().sum_dim(1).transpose();
        let distances = squares - vectors.matmul(self.entries.clone().transpose()).mul_scalar(2.0);
        distances.argmin(1).reshape([vector_count])
    }

    /// Looks up entries by index, `[n, channels]`.
    pub fn lookup(&self, indices: Tensor<B, 1, Int>) -> Tensor<B, 2> {
        self.entries.clone().select(0, indices)
    }

    /// Returns the nearest entry of each of `[batch, codes, channels]` vectors, in their place.
    pub fn quantised(&self, vectors: Tensor<B, 3>) -> Tensor<B, 3> {
        let [batch, codes, channels] = vectors.dims();
        let indices = self.nearest(vectors.reshape([batch * codes, channels]));
        self.lookup(indices).reshape([batch, codes, channels])
    }

    /// Moves the averages towards a batch, then replaces entries whose count fell below
    /// `restart_below` by vectors of the batch. Returns how many were replaced, `[1]`.
    ///
    /// A replaced entry starts over with a count of one, so that it is always sum over count.
    pub fn update(
        &mut self,
        vectors: Tensor<B, 2>,
        indices: Tensor<B, 1, Int>,
        settings: MovingAverage,
        random: &mut ChaCha8Rng,
    ) -> Tensor<B, 1> {
        let codes = self.codes();
        let assigned = self.one_hot(indices);
        let decay = settings.decay;
        let average = |old: Tensor<B, 2>, new: Tensor<B, 2>| {
            old.mul_scalar(decay) + new.mul_scalar(1.0 - decay)
        };
        let counts = assigned.clone().sum_dim(0).reshape([codes, 1]);
        let sums = assigned.transpose().matmul(vectors.clone());
        let counts = average(self.counts.clone(), counts);
        let sums = average(self.sums.clone(), sums);
        let stale = counts.clone().lower_elem(settings.restart_below);
        let fresh = candidates(vectors, codes, random);
        let [_, channels] = fresh.dims();
        let stale_rows = stale.clone().expand([codes, channels]);
        self.sums = sums.mask_where(stale_rows, fresh);
        self.counts = counts.mask_fill(stale.clone(), 1.0);
        self.entries = self.sums.clone() / self.counts.clone();
        stale.float().sum()
    }

    /// Returns `exp` of the entropy of the codes' use: the number of codes in effective use, `[1]`.
    pub fn perplexity(&self, indices: Tensor<B, 1, Int>) -> Tensor<B, 1> {
        let share = self.one_hot(indices).mean_dim(0);
        let entropy = share.clone() * share.add_scalar(1e-10).log();
        entropy.sum().neg().exp()
    }

    /// `[n, codes]`.
    fn one_hot(&self, indices: Tensor<B, 1, Int>) -> Tensor<B, 2> {
        let [vector_count] = indices.dims();
        let codes = self.codes();
        let all = Tensor::<B, 1, Int>::arange(0..codes as i64, &self.device).reshape([1, codes]);
        let all = all.expand([vector_count, codes]);
        let wanted = indices.reshape([vector_count, 1]).expand([vector_count, codes]);
        wanted.equal(all).float()
    }
}

/// How the averages move.
#[derive(Clone, Copy, Debug)]
pub struct MovingAverage {
    /// Share of the old average that a step keeps.
    pub decay: f64,
    /// Average count below which an entry is replaced.
    pub restart_below: f64,
}

fn loaded<B: Backend>(tensor: &HostTensor, device: &B::Device) -> Tensor<B, 2> {
    let shape = [tensor.dim(0), tensor.dim(1)];
    numbers(tensor.data().to_vec(), shape, device)
}

/// Draws `count` different rows of `vectors`; too few rows are repeated, with noise.
fn candidates<B: Backend>(
    vectors: Tensor<B, 2>,
    count: usize,
    random: &mut ChaCha8Rng,
) -> Tensor<B, 2> {
    let [available, channels] = vectors.dims();
    let device = vectors.device();
    let mut rows: Vec<i32> =
        (0..count.max(available)).map(|index| (index % available.max(1)) as i32).collect();
    // The first `count` places of a shuffle.
    for place in 0..count.min(rows.len()) {
        let left = (rows.len() - place) as u64;
        rows.swap(place, place + (random.next_u64() % left) as usize);
    }
    rows.truncate(count);
    let chosen = vectors.select(0, codes(rows, [count], &device));
    if available >= count {
        return chosen;
    }
    let spread = COPY_NOISE / (channels as f64).sqrt();
    chosen + Tensor::random([count, channels], Distribution::Normal(0.0, spread), &device)
}
