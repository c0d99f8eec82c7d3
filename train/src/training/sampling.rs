//! Sampling of whole pieces from the policy as it stands, many pieces side by side.

use burn_tensor::{Int, Tensor};
use ndarray::ArrayView2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::nn::{self, GptNet, Kernels, KvCache, Parameters, gathered, numbers, values};

/// A piece to be generated.
pub(super) struct SamplingRequest<'a> {
    /// Scaled music; row `k + 1` is beside code `k`, so there is one row more than codes.
    pub(super) music: ArrayView2<'a, f32>,
    /// Upper and lower code to start from.
    pub(super) start: [i32; 2],
    /// The piece's own random numbers: it is the same beside any other pieces.
    pub(super) random: ChaCha8Rng,
}

impl<'a> SamplingRequest<'a> {
    /// Requests a piece that starts with one of `starts`.
    pub(super) fn new(
        music: ArrayView2<'a, f32>,
        starts: &[[u32; 2]],
        mut random: ChaCha8Rng,
    ) -> Self {
        let start = (random.random::<f64>() * starts.len() as f64) as usize;
        // Without starts every code is as good as the first.
        let start = starts.get(start).copied().unwrap_or([0; 2]);
        Self { music, start: start.map(|code| code as i32), random }
    }
}

/// Draws codes from the policy.
pub(super) struct Sampler<'a, B: Kernels> {
    pub(super) net: &'a GptNet,
    pub(super) parameters: &'a Parameters<B>,
    /// 0 takes the most likely code, as published.
    pub(super) temperature: f64,
}

impl<B: Kernels> Sampler<'_, B> {
    /// Generates the codes of each piece. Histories slide as in ARCHITECTURE section 3 with `s =
    /// 28`: every step sees the last 28 codes re-indexed from position 0. Keys and values are
    /// cached until the histories slide; from then on every step computes its whole window, and
    /// pieces side by side keep the device busy.
    pub(super) fn generate(&self, mut requests: Vec<SamplingRequest<'_>>) -> Vec<[Vec<i32>; 2]> {
        let mut pieces: Vec<[Vec<i32>; 2]> =
            requests.iter().map(|request| request.start.map(|code| vec![code])).collect();
        let longest = requests.iter().map(|request| request.music.nrows()).max().unwrap_or(0);
        let cache = self.net.empty_cache();
        let mut cache = cache.map(|cache| (cache, (0..requests.len()).collect()));
        for known in 1..longest.saturating_sub(1) {
            let unfinished: Vec<usize> = (0..requests.len())
                .filter(|&piece| known + 1 < requests[piece].music.nrows())
                .collect();
            if known >= self.net.block() {
                cache = None;
            }
            let logits = match &mut cache {
                Some(cache) => self.extended(cache, &requests, &pieces, &unfinished),
                None => self.logits(&requests, &pieces, &unfinished, known),
            };
            let drawn = self.drawn(&logits, &mut requests, &unfinished);
            for (&piece, codes) in unfinished.iter().zip(drawn) {
                let halves = pieces[piece].iter_mut().zip(codes);
                halves.for_each(|(half, code)| half.push(code));
            }
        }
        pieces
    }

    /// Draws the next upper and lower code of the given pieces, each by its own random numbers.
    fn drawn(
        &self,
        logits: &[Vec<f32>; 2],
        requests: &mut [SamplingRequest<'_>],
        unfinished: &[usize],
    ) -> Vec<[i32; 2]> {
        let (temperature, one_code) = (self.temperature, self.net.has_one_code());
        let pieces = requests.iter_mut().enumerate();
        let mut pieces: Vec<&mut ChaCha8Rng> = pieces
            .filter(|(piece, _)| unfinished.binary_search(piece).is_ok())
            .map(|(_, request)| &mut request.random)
            .collect();
        let count = pieces.len();
        let drawn = pieces.par_iter_mut().enumerate().map(|(place, random)| {
            let mut next = |logits: &[f32]| {
                let vocabulary = logits.len() / count;
                draw(&logits[place * vocabulary..][..vocabulary], temperature, random) as i32
            };
            let upper = next(&logits[0]);
            [upper, if one_code { upper } else { next(&logits[1]) }]
        });
        drawn.collect()
    }

    /// Generates pieces of vectors in place of codes, from their first vectors on: the network's
    /// output is taken as it is, nothing is drawn.
    pub(super) fn regress(
        &self,
        requests: &[SamplingRequest<'_>],
        mut pieces: Vec<[Vec<f32>; 2]>,
    ) -> Vec<[Vec<f32>; 2]> {
        for (request, piece) in requests.iter().zip(&mut pieces) {
            let channels = piece[0].len();
            for known in 1..request.music.nrows().saturating_sub(1) {
                let window = known.min(self.net.block() - 1);
                let first = known - window;
                let device = self.parameters.device();
                let rows = request.music.rows().into_iter().skip(first + 1).take(window);
                let rows: Vec<f32> = rows.flatten().copied().collect();
                let tensor = |values: Vec<f32>| {
                    let shape = [1, window, values.len() / window];
                    numbers::<B, 3>(values, shape, device)
                };
                let history =
                    [0, 1].map(|half: usize| tensor(piece[half][first * channels..].to_vec()));
                let found = self.net.regress(self.parameters, tensor(rows), history, 0.0);
                for (half, found) in piece.iter_mut().zip([found.upper, found.lower]) {
                    half.extend(values(&found.narrow(1, window - 1, 1)));
                }
            }
        }
        pieces
    }

    /// Computes the scores of the next code of the given pieces, one after the other. The cache
    /// holds all codes but the last of the pieces that it lists, and afterwards those of the given
    /// ones.
    fn extended(
        &self,
        (cache, cached): &mut (KvCache<B>, Vec<usize>),
        requests: &[SamplingRequest<'_>],
        pieces: &[[Vec<i32>; 2]],
        unfinished: &[usize],
    ) -> [Vec<f32>; 2] {
        let device = self.parameters.device();
        if cached != unfinished {
            let places = (0..).zip(cached.iter());
            let places = places.filter(|(_, piece)| unfinished.contains(piece));
            let places: Vec<i32> = places.map(|(place, _)| place).collect();
            let length = places.len();
            *cache = cache.clone().of(&nn::codes(places, [length], device));
            unfinished.clone_into(cached);
        }
        let newest: Vec<_> = unfinished
            .iter()
            .map(|&piece| Window {
                music: requests[piece].music,
                codes: &pieces[piece],
                first: pieces[piece][0].len() - 1,
            })
            .collect();
        let (music, codes) = inputs(&newest, 1, device);
        let logits = self.net.extend(self.parameters, cache, music, codes);
        [logits.upper, logits.lower].map(|logits| values(&logits))
    }

    /// Computes the scores of code `known` of the given pieces, one after the other.
    fn logits(
        &self,
        requests: &[SamplingRequest<'_>],
        pieces: &[[Vec<i32>; 2]],
        unfinished: &[usize],
        known: usize,
    ) -> [Vec<f32>; 2] {
        let window = known.min(self.net.block() - 1);
        let first = known - window;
        let excerpts: Vec<_> = unfinished
            .iter()
            .map(|&piece| Window { music: requests[piece].music, codes: &pieces[piece], first })
            .collect();
        let device = self.parameters.device();
        let (music, codes) = inputs(&excerpts, window, device);
        let logits = self.net.forward(self.parameters, music, codes, 0.0);
        [logits.upper, logits.lower].map(|logits| values(&logits.narrow(1, window - 1, 1)))
    }
}

/// A part of a piece, from code `first` on.
pub(super) struct Window<'a> {
    pub(super) music: ArrayView2<'a, f32>,
    pub(super) codes: &'a [Vec<i32>; 2],
    pub(super) first: usize,
}

/// Gathers music and codes of windows of `steps` codes, as the network takes them.
pub(super) fn inputs<B: Kernels>(
    windows: &[Window<'_>],
    steps: usize,
    device: &B::Device,
) -> (Tensor<B, 3>, [Tensor<B, 2, Int>; 2]) {
    let columns = windows.first().map_or(0, |window| window.music.ncols());
    let row = |window: &Window<'_>, step: usize| window.music.row(window.first + 1 + step).to_vec();
    let music = gathered(windows, [steps, columns], row, device);
    let count = windows.len();
    let codes = [0, 1].map(|half| {
        let windows = windows.iter();
        let codes = windows.flat_map(|window| &window.codes[half][window.first..][..steps]);
        nn::codes(codes.copied(), [count, steps], device)
    });
    (music, codes)
}

/// Draws a code by its score; the first of the highest at temperature 0.
fn draw(logits: &[f32], temperature: f64, random: &mut ChaCha8Rng) -> usize {
    let better = |best: usize, code: usize| {
        if logits[code] > logits[best] { code } else { best }
    };
    let best = (0..logits.len()).reduce(better).unwrap_or(0);
    if temperature == 0.0 {
        return best;
    }
    let weight = |code: usize| {
        let distance = f64::from(logits[code]) - f64::from(logits[best]);
        (distance / temperature).exp()
    };
    let total: f64 = (0..logits.len()).map(weight).sum();
    let mut rest = random.random::<f64>() * total;
    let reached = |&code: &usize| {
        rest -= weight(code);
        rest < 0.0
    };
    // Rounding may leave a sliver beyond the last weight.
    (0..logits.len()).find(reached).unwrap_or(best)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use burn_flex::{Flex, FlexDevice};
    use ndarray::{Array1, Array2, Axis, Slice};

    use super::*;
    use crate::{
        checkpoint::TorchCheckpoint,
        nn::{GptSizes, Store, random_gpt},
        training::windows::generator,
        weights::GptWeights,
    };

    fn fixture(name: &str) -> PathBuf {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/model");
        PathBuf::from(folder).join(name)
    }

    fn golden_codes(name: &str) -> Vec<i32> {
        let codes: Array1<i64> = ndarray_npy::read_npy(fixture(name)).unwrap();
        codes.iter().map(|&code| code as i32).collect()
    }

    #[test]
    fn the_most_likely_codes_are_the_golden_ones() {
        let mut checkpoint = TorchCheckpoint::open(&fixture("tiny_gpt.pt")).unwrap();
        let weights = GptWeights::from_checkpoint(&mut checkpoint, 4).unwrap();
        let mut store = Store::default();
        let net = GptNet::new(&weights, &mut store);
        let sampler = Sampler {
            net: &net,
            parameters: &Parameters::<Flex>::from_store(&store, &FlexDevice),
            temperature: 0.0,
        };
        let music: Array2<f32> = ndarray_npy::read_npy(fixture("music.npy")).unwrap();
        let start = golden_codes("start_codes.npy");
        let start = [start[0], start[1]];
        // Shorter pieces beside it end earlier, with the cache and after it, and have the same
        // codes.
        let request = |rows: usize| SamplingRequest {
            music: music.slice_axis(Axis(0), Slice::from(..rows)),
            start,
            random: generator(1, 2),
        };
        let pieces = sampler.generate(vec![request(20), request(60), request(35)]);
        for (half, name) in ["codes_slide_up.npy", "codes_slide_down.npy"].into_iter().enumerate() {
            let golden = golden_codes(name);
            for (piece, codes) in pieces.iter().zip([19, 59, 34]) {
                assert_eq!(piece[half], golden[..codes]);
            }
        }
    }

    /// A piece that fits into the window: each vector is what the network gives after those before
    /// it, which one pass over the whole piece computes for all at once.
    #[test]
    fn vectors_follow_those_before_them() {
        const STEPS: usize = 5;
        let sizes = GptSizes {
            channels: 8,
            heads: 2,
            layers: 2,
            block: STEPS + 1,
            codes: [3, 3],
            columns: 2,
        };
        let mut store = Store::default();
        let net = GptNet::new(&random_gpt(sizes, 4), &mut store);
        let parameters = &Parameters::<Flex>::from_store(&store, &FlexDevice);
        let music =
            Array2::from_shape_fn((STEPS + 2, 2), |(row, column)| (row * 2 + column) as f32);
        let sampler = Sampler { net: &net, parameters, temperature: 1.0 };
        let request =
            SamplingRequest { music: music.view(), start: [0, 0], random: generator(1, 2) };
        let start = [vec![1.0, -2.0, 0.5], vec![0.3, 0.0, 4.0]];
        let piece = &sampler.regress(&[request], vec![start.clone()])[0];
        let tensor = |values: &[f32], columns| {
            let shape = [1, STEPS, columns];
            numbers::<Flex, 3>(values.to_vec(), shape, &FlexDevice)
        };
        // Row 1 is beside the first vector.
        let rows: Vec<f32> = music.iter().skip(2).take(2 * STEPS).copied().collect();
        let history = [0, 1].map(|half: usize| tensor(&piece[half][..3 * STEPS], 3));
        let found = net.regress(parameters, tensor(&rows, 2), history, 0.0);
        for (half, found) in [found.upper, found.lower].iter().enumerate() {
            assert_eq!(piece[half].len(), 3 * (STEPS + 1));
            assert_eq!(piece[half][..3], start[half]);
            let pairs = values(found).into_iter().zip(&piece[half][3..]);
            pairs.for_each(|(wanted, found)| assert!((wanted - found).abs() < 1e-5));
        }
    }

    #[test]
    fn codes_are_drawn_by_their_scores() {
        let logits = [0.0, 2.0, -1.0, 2.0];
        let mut random = generator(5, 0);
        assert_eq!(draw(&logits, 0.0, &mut random), 1);
        let mut counts = [0.0; 4];
        for _ in 0..20_000 {
            counts[draw(&logits, 2.0, &mut random)] += 1.0 / 20_000.0;
        }
        let total: f64 = logits.iter().map(|&x| f64::from(x / 2.0).exp()).sum();
        for (share, logit) in counts.into_iter().zip(logits) {
            let wanted = f64::from(logit / 2.0).exp() / total;
            assert!((share - wanted).abs() < 0.02, "{share} {wanted}");
        }
    }
}
