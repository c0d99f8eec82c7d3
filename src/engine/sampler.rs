//! From logits to codes: argmax as in the paper, or temperature and top-k with a seeded generator.

use rand::{RngExt, SeedableRng, TryRng, rngs::SysRng};
use rand_chacha::ChaCha8Rng;

use super::EngineError;

/// Largest seed: the largest integer that every JSON reader keeps exact (2^53 - 1).
pub const MAX_SEED: u64 = (1 << 53) - 1;

/// How the next code is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sampling {
    /// 0 takes the most likely code.
    pub(crate) temperature: f32,
    /// Draw from this many most likely codes.
    pub(crate) top_k: Option<usize>,
}

/// The one generator of a request, and the rule that turns its numbers into codes.
#[derive(Clone, Debug)]
pub(crate) struct Sampler {
    sampling: Sampling,
    generator: ChaCha8Rng,
    // (logit, code) of the candidates, kept to avoid an allocation per step.
    candidates: Vec<(f32, u32)>,
}

impl Sampler {
    pub(crate) fn new(sampling: Sampling, seed: u64) -> Self {
        let generator = ChaCha8Rng::seed_from_u64(seed);
        Self { sampling, generator, candidates: Vec::new() }
    }

    /// A sampler that draws other numbers of the same seed: those of a stream, the first of which
    /// is 0.
    pub(crate) fn stream(&self, number: u64) -> Self {
        let mut other = self.clone();
        other.generator.set_stream(number);
        other
    }

    /// One of `0..count`, uniformly; for start codes.
    pub(crate) fn uniform(&mut self, count: usize) -> usize {
        self.generator.random_range(0..count.max(1))
    }

    /// Chooses the next code of those given with their logits. Argmax takes the first maximum;
    /// top-k comes before temperature.
    pub(crate) fn next(&mut self, logits: impl Iterator<Item = (u32, f32)>) -> u32 {
        if self.sampling.temperature == 0.0 {
            return argmax(logits);
        }
        self.candidates.clear();
        self.candidates.extend(logits.map(|(code, logit)| (logit, code)));
        // Most likely first, smaller code first on ties, so that a seed means the same everywhere.
        self.candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        self.candidates.truncate(self.sampling.top_k.unwrap_or(usize::MAX).max(1));
        self.draw()
    }

    fn draw(&mut self) -> u32 {
        let highest = self.candidates.first().map_or(0.0, |c| f64::from(c.0));
        let temperature = f64::from(self.sampling.temperature);
        let weight = |logit: f32| ((f64::from(logit) - highest) / temperature).exp();
        let total: f64 = self.candidates.iter().map(|c| weight(c.0)).sum();
        let mut rest = self.generator.random::<f64>() * total;
        for &(logit, code) in &self.candidates {
            rest -= weight(logit);
            if rest < 0.0 {
                return code;
            }
        }
        // Rounding left a sliver beyond the last weight.
        self.candidates.last().map_or(0, |c| c.1)
    }
}

fn argmax(logits: impl Iterator<Item = (u32, f32)>) -> u32 {
    let mut best = (f32::NEG_INFINITY, 0);
    for (code, logit) in logits {
        if logit > best.0 {
            best = (logit, code);
        }
    }
    best.1
}

/// A seed from the operating system, for requests that name none.
///
/// # Errors
/// [`EngineError::NoRandomness`] when the system has none to give.
pub(crate) fn draw_seed() -> Result<u64, EngineError> {
    // 32 bits: short enough to be read out and typed again.
    SysRng.try_next_u32().map(u64::from).map_err(|e| EngineError::NoRandomness(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampler(temperature: f32, top_k: Option<usize>, seed: u64) -> Sampler {
        Sampler::new(Sampling { temperature, top_k }, seed)
    }

    /// Every code, with these logits.
    fn all<const N: usize>(logits: [f32; N]) -> impl Iterator<Item = (u32, f32)> {
        (0..).zip(logits)
    }

    #[test]
    fn zero_temperature_takes_the_first_maximum() {
        let mut sampler = sampler(0.0, None, 1);
        assert_eq!(sampler.next(all([0.5, 2.0, 2.0, -1.0])), 1);
        let some = all([0.5, 2.0, 2.0, -1.0]).filter(|&(code, _)| code != 1);
        assert_eq!(sampler.next(some), 2);
    }

    #[test]
    fn draws_follow_the_softmax() {
        let logits = [0.0f32, 1.0, 2.0];
        let mut sampler = sampler(0.5, None, 7);
        let mut counts = [0.0f64; 3];
        for _ in 0..20_000 {
            counts[sampler.next(all(logits)) as usize] += 1.0;
        }
        let weights = logits.map(|l| f64::from(l / 0.5).exp());
        let total: f64 = weights.iter().sum();
        for (count, weight) in counts.iter().zip(weights) {
            let (expected, got) = (weight / total, count / 20_000.0);
            // Four standard deviations of a binomial share.
            let tolerance = 4.0 * (expected * (1.0 - expected) / 20_000.0).sqrt();
            assert!((expected - got).abs() < tolerance, "{expected} {got}");
        }
    }

    #[test]
    fn top_k_never_leaves_the_most_likely() {
        let mut sampler = sampler(10.0, Some(2), 3);
        for _ in 0..500 {
            assert!([1, 3].contains(&sampler.next(all([0.0, 5.0, 1.0, 4.0]))));
        }
    }

    #[test]
    fn streams_of_a_seed_differ_and_repeat_themselves() {
        let seeded = sampler(1.0, None, 5);
        let draw = |stream: u64| {
            let mut sampler = seeded.stream(stream);
            (0..50).map(|_| sampler.next(all([0.1, 0.2, 0.3, 0.4]))).collect::<Vec<_>>()
        };
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
        assert_ne!(draw(1), draw(0));
    }

    #[test]
    fn a_seed_repeats_itself() {
        let draw = |seed| {
            let mut sampler = sampler(1.0, None, seed);
            (0..50).map(|_| sampler.next(all([0.1, 0.2, 0.3, 0.4]))).collect::<Vec<_>>()
        };
        assert_eq!(draw(5), draw(5));
        assert_ne!(draw(5), draw(6));
    }
}
