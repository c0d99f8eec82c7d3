//! One request in the making: the codes so far, and what its dances in the batch ask of the model.

use std::sync::Arc;

use ndarray::{ArrayView2, Axis, Slice};

use super::{
    chunks::{Chunk, ChunkPlan},
    frames::SharedDecoder,
    guidance::Guide,
    sampler::Sampler,
    search::{Judge, Phrase, may_freeze, phrase_end},
    window::WindowStep,
    worker::{Job, branches},
};
use crate::{
    Result,
    formats::Codes,
    model::{Gpt, GptMemory, Logits, Manifest, ModelError, NextStep, Steps},
};

/// A request whose codes are being chosen, phrase by phrase. Its dances, one or a candidate each, go side
/// by side; at a phrase's start nothing that the model remembers of them is needed.
pub(crate) struct Piece {
    job: Arc<Job>,
    /// Upper and lower codes that may be drawn.
    drawable: [Vec<u32>; 2],
    guide: Option<Guide>,
    /// The request's generator, which serves a single dance throughout.
    sampler: Sampler,
    settled: Codes,
    dances: Vec<Dancing>,
    /// How many phrases are settled.
    phrases: u64,
    /// Number of codes at the end of the current one.
    end: usize,
    candidates: Phrase,
    /// The model remembers nothing of these dances yet.
    unprimed: bool,
    /// What is to be decoded when.
    plan: ChunkPlan,
}

/// One of the dances that a phrase could become.
struct Dancing {
    codes: Codes,
    sampler: Sampler,
}

impl Piece {
    /// Before its first step.
    pub(crate) fn new(job: Arc<Job>, manifest: &Manifest) -> Self {
        let mut sampler = Sampler::new(job.sampling, job.seed);
        let drawable = manifest.suppressed_codes.others(manifest.vocabulary);
        let pairs = &manifest.start_codes;
        let drawn = start_codes(job.start, pairs, &drawable, &mut sampler);
        let leads = |half: &[u32]| half.last().copied();
        let [upper, lower] = [
            leads(&job.history.upper).unwrap_or(drawn[0]),
            leads(&job.history.lower).unwrap_or(drawn[1]),
        ];
        let total = job.music.nrows() - job.lead_in().unwrap_or(0);
        let receptive = manifest.decoder.receptive_codes;
        let plan = ChunkPlan::new(total, job.history.clone(), receptive);
        let mut piece = Self {
            guide: Guide::new(job.guidance, job.music.view()),
            plan: match &job.listener {
                Some(_) => plan.soon(),
                None => plan,
            },
            job,
            drawable,
            sampler,
            settled: Codes {
                upper: vec![upper],
                lower: vec![lower],
            },
            dances: Vec::new(),
            phrases: 0,
            end: 0,
            candidates: Phrase::default(),
            unprimed: true,
        };
        piece.begin_phrase();
        piece
    }

    pub(crate) fn job(&self) -> &Job {
        &self.job
    }

    /// Codes of the whole piece, and the one that leads in.
    fn total(&self) -> usize {
        self.job.music.nrows()
    }

    /// Rows of the batch that it takes.
    pub(crate) fn rows(&self) -> usize {
        self.job.rows()
    }

    /// With and without the music's time, if it is guided.
    fn branches(&self) -> usize {
        branches(self.job.guidance)
    }

    /// Whether all codes are chosen.
    pub(crate) fn has_all_codes(&self) -> bool {
        self.settled.upper.len() >= self.total()
    }

    /// Whether it is at a phrase's start, where it can leave the batch and come back at no cost.
    pub(crate) fn can_rest(&self) -> bool {
        self.unprimed
    }

    fn begin_phrase(&mut self) {
        let settled = self.settled.upper.len();
        self.end = match self.job.is_judged() {
            true => phrase_end(settled, self.total(), self.job.window),
            false => (settled + 1..self.total())
                .find(|&length| self.job.window.moves_at(length - 1))
                .unwrap_or_else(|| self.total()),
        };
        self.candidates = Phrase::default();
        self.begin_candidates();
    }

    /// Each with a generator of its own, so that it comes out the same however many go side by side.
    fn begin_candidates(&mut self) {
        self.unprimed = true;
        let dancing = |sampler: Sampler| Dancing {
            codes: self.settled.clone(),
            sampler,
        };
        if !self.job.is_judged() {
            self.dances = vec![dancing(self.sampler.clone())];
            return;
        }
        let tried = self.candidates.tried();
        self.dances = (tried..tried + self.job.tries())
            .map(|candidate| {
                let number = self.phrases << 32 | candidate as u64;
                dancing(self.sampler.stream(number + 1))
            })
            .collect();
    }

    /// Makes the model remember what the next step needs: the codes of the window before the newest,
    /// where it moved or nothing is remembered. The piece's rows begin at `first`.
    pub(crate) fn prime(
        &mut self,
        gpt: &mut Gpt,
        memory: &mut GptMemory,
        first: usize,
    ) -> Result<(), ModelError> {
        let step = self.step();
        let start = match self.job.window.at(step) {
            WindowStep::Prime { start } => start,
            WindowStep::Extend if self.unprimed => self.job.window.start(step),
            WindowStep::Extend => return Ok(()),
        };
        let count = self.dances.len();
        for branch in 0..self.branches() {
            let music = self.music(branch);
            for (number, dance) in self.dances.iter().enumerate() {
                let row = first + branch * count + number;
                if self.unprimed && number > 0 {
                    // All of them are the settled codes still.
                    memory.copy(row - 1..row, row);
                    continue;
                }
                memory.forget(row);
                if start < step {
                    let steps = steps(&dance.codes, music, start..step);
                    gpt.prime(memory, row, steps, &self.job.cancel)?;
                }
            }
        }
        self.unprimed = false;
        Ok(())
    }

    /// Index of the newest code.
    fn step(&self) -> usize {
        let codes = self
            .dances
            .first()
            .map_or(0, |dance| dance.codes.upper.len());
        codes.saturating_sub(1)
    }

    /// The music that a branch hears.
    fn music(&self, branch: usize) -> ArrayView2<'_, f32> {
        match (&self.guide, branch) {
            (Some(guide), 1) => guide.timeless(),
            _ => self.job.music.view(),
        }
    }

    /// The newest step of every row.
    pub(crate) fn next_steps(&self) -> impl Iterator<Item = NextStep<'_>> {
        let step = self.step();
        (0..self.branches()).flat_map(move |branch| {
            let music = self.music(branch);
            self.dances.iter().map(move |dance| NextStep {
                upper: dance.codes.upper.last().copied().unwrap_or_default(),
                lower: dance.codes.lower.last().copied().unwrap_or_default(),
                // The row beside code k is k + 1: the reference drops the first row.
                music: music.index_axis_move(Axis(0), step + 1),
            })
        })
    }

    /// Chooses the next code of every dance from its row of `logits`; the piece's begin at `first`.
    pub(crate) fn choose(&mut self, logits: &Logits, first: usize) {
        let count = self.dances.len();
        let guide = self.guide.as_ref();
        for (number, Dancing { codes, sampler }) in self.dances.iter_mut().enumerate() {
            let row = first + number;
            // Upper first: one generator serves both halves in this order.
            let halves = [
                (&logits.upper, &mut codes.upper),
                (&logits.lower, &mut codes.lower),
            ];
            for ((logits, codes), drawable) in halves.into_iter().zip(&self.drawable) {
                let heard = logits.row(row);
                let code = match guide {
                    Some(guide) => {
                        let led = guide.lead(heard, logits.row(row + count));
                        sampler.next(of_codes(drawable, led))
                    }
                    None => sampler.next(of_codes(drawable, heard.iter().copied())),
                };
                codes.push(code);
            }
        }
    }

    /// Ends the phrase if it is whole, and begins the next.
    pub(crate) fn settle(&mut self, decoder: &SharedDecoder, manifest: &Manifest) -> Result<()> {
        let total = self.total();
        if self.step() + 1 < self.end {
            if !self.job.is_judged() {
                self.tell(self.step() + 1);
            }
            return Ok(());
        }
        let dances = std::mem::take(&mut self.dances);
        let settled = self.settled.upper.len();
        let doubtful = |dance: &Dancing| may_freeze(&dance.codes, settled);
        if self.job.has_a_choice() || self.job.redo && dances.iter().any(doubtful) {
            let codes: Vec<&Codes> = dances.iter().map(|dance| &dance.codes).collect();
            let mut free = decoder.lock();
            let mut judge = Judge {
                beats: &self.job.beats,
                decoder: &mut free,
                manifest,
                cancel: &self.job.cancel,
            };
            let verdicts = judge.judge(&codes, settled, self.end == total);
            drop(free);
            let verdicts = verdicts?;
            for (verdict, dance) in verdicts.into_iter().zip(dances) {
                self.candidates.consider(verdict, dance.codes);
            }
            if self.job.redo && self.candidates.goes_on(self.job.tries()) {
                self.begin_candidates();
                return Ok(());
            }
            if let Some(best) = std::mem::take(&mut self.candidates).into_best() {
                self.settled = best;
            }
        } else if let Some(dance) = dances.into_iter().next() {
            self.settled = dance.codes;
            if !self.job.is_judged() {
                self.sampler = dance.sampler;
            }
        }
        self.phrases += 1;
        self.tell(self.end);
        if !self.has_all_codes() {
            self.begin_phrase();
        }
        Ok(())
    }

    /// Tells how many codes there are, the one that leads in not counted.
    fn tell(&self, codes: usize) {
        let leads = self.job.lead_in().unwrap_or(0);
        let progress = &self.job.progress;
        progress.codes(codes - leads, self.total() - leads);
    }

    /// The next chunk of codes that can be decoded.
    pub(crate) fn next_chunk(&mut self) -> Option<Chunk> {
        let leads = self.job.lead_in().unwrap_or(0);
        let halves = [&self.settled.upper, &self.settled.lower];
        let codes = halves.map(|half| half.get(leads..).unwrap_or_default());
        self.plan.next(codes)
    }

    /// The codes of the whole dance, once there are no more chunks.
    pub(crate) fn end(&self) -> Option<Codes> {
        let leads = self.job.lead_in().unwrap_or(0);
        let behind = |half: &[u32]| half.get(leads..).unwrap_or_default().to_vec();
        self.plan.is_complete().then(|| Codes {
            upper: behind(&self.settled.upper),
            lower: behind(&self.settled.lower),
        })
    }
}

/// Codes with their rows of music.
fn steps<'a>(
    codes: &'a Codes,
    music: ArrayView2<'a, f32>,
    range: std::ops::Range<usize>,
) -> Steps<'a> {
    Steps {
        upper: codes.upper.get(range.clone()).unwrap_or_default(),
        lower: codes.lower.get(range.clone()).unwrap_or_default(),
        music: music.slice_axis_move(Axis(0), Slice::from(range.start + 1..range.end + 1)),
    }
}

/// The logits of some codes, ascending, out of those of all.
fn of_codes(codes: &[u32], logits: impl Iterator<Item = f32>) -> impl Iterator<Item = (u32, f32)> {
    let mut wanted = codes.iter().copied().peekable();
    (0..)
        .zip(logits)
        .filter(move |&(code, _)| wanted.next_if_eq(&code).is_some())
}

/// The start pair: given codes win; the rest is drawn as a pair from the manifest's list, or from
/// all that may be drawn when it has none. Both numbers are drawn always, so that giving one half
/// does not change the dance's other draws.
fn start_codes(
    given: [Option<u32>; 2],
    pairs: &[[u32; 2]],
    drawable: &[Vec<u32>; 2],
    sampler: &mut Sampler,
) -> [u32; 2] {
    let drawn = match pairs {
        [] => drawable.each_ref().map(|codes| {
            let place = sampler.uniform(codes.len());
            codes.get(place).copied().unwrap_or_default()
        }),
        pairs => pairs
            .get(sampler.uniform(pairs.len()))
            .copied()
            .unwrap_or_default(),
    };
    [given[0].unwrap_or(drawn[0]), given[1].unwrap_or(drawn[1])]
}

#[cfg(test)]
mod tests {
    use super::{super::sampler::Sampling, *};

    #[test]
    fn logits_of_some_codes_keep_their_codes() {
        let found: Vec<_> = of_codes(&[0, 2, 3], [0.5, 1.5, 2.5, 3.5].into_iter()).collect();
        assert_eq!(found, [(0, 0.5), (2, 2.5), (3, 3.5)]);
    }

    #[test]
    fn starts_are_drawn_from_pairs_or_from_what_may_be_drawn() {
        let sampling = Sampling {
            temperature: 1.0,
            top_k: None,
        };
        let mut sampler = Sampler::new(sampling, 3);
        let drawable = [vec![4], vec![1, 9]];
        let mut seen = [0; 2];
        for _ in 0..50 {
            let [upper, lower] = start_codes([None; 2], &[], &drawable, &mut sampler);
            assert!(upper == 4 && [1, 9].contains(&lower));
            seen[usize::from(lower == 9)] += 1;
        }
        assert!(seen.iter().all(|&count| count > 5), "{seen:?}");
        let given = start_codes([None, Some(7)], &[[2, 3]], &drawable, &mut sampler);
        assert_eq!(given, [2, 7]);
    }
}
