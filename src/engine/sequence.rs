//! The code sequence of one request: its codes so far, and what its candidates ask of the model.

use std::{ops::Range, sync::Arc};

use ndarray::{ArrayView2, Axis, Slice};

use super::{
    EngineError, Progress,
    chunks::{Chunk, ChunkPlan},
    code_model::{CodeModel, SharedDecoder},
    conditioning::{Conditioning, PROMPT_CODES},
    form::favouring,
    guidance::{ClassifierFreeGuidance, branches},
    options::SamplingParams,
    sampler::Sampler,
    scorer::Scorer,
    segment::{Segment, may_freeze, segment_end},
    start_codes::start_codes,
    window::WindowStep,
};
use crate::model::{Logits, Manifest, NextStep, Steps};

/// What a sequence is generated from.
pub(crate) struct SequenceRequest {
    /// The music, with a row for the prompt where there is one.
    pub(crate) conditioning: Conditioning,
    pub(crate) params: SamplingParams,
    /// Codes that the sequence continues. The last of them is given as its first code: it stands
    /// before the first row of music, and is no part of the result.
    pub(crate) prompt: Vec<[u32; 2]>,
    /// Style of the dance; none from a model without styles.
    pub(crate) style: Option<String>,
    /// Whether the motion begins inside the prompt's last code, which is decoded again then.
    pub(crate) resumes: bool,
    pub(crate) progress: Arc<dyn Progress>,
    /// Whether the first frames are wanted soon.
    pub(crate) soon: bool,
}

impl SequenceRequest {
    /// Whether there are candidates, and beats to choose between them by.
    fn has_a_choice(&self) -> bool {
        self.params.candidates > 1 && !self.conditioning.beats.is_empty()
    }

    /// Whether segments are scored: to choose between candidates, or to generate them again.
    fn is_scored(&self) -> bool {
        self.has_a_choice() || self.params.redo
    }

    /// Candidates of a segment that are tried at once.
    fn candidates(&self) -> usize {
        match self.has_a_choice() {
            true => self.params.candidates,
            false => 1,
        }
    }

    /// Committed codes that the motion does not begin with.
    fn undecoded(&self) -> usize {
        match self.resumes {
            true => 0,
            false => self.given(),
        }
    }

    /// Codes that are given by the prompt.
    fn given(&self) -> usize {
        match self.prompt.is_empty() {
            true => 0,
            false => PROMPT_CODES,
        }
    }
}

/// A sequence whose codes are chosen segment by segment. Its candidates, one or several, are
/// computed side by side; at a segment's start the cache need not hold anything of them.
pub(crate) struct Sequence {
    request: SequenceRequest,
    /// Upper and lower codes that may be drawn.
    drawable: [Vec<u32>; 2],
    guidance: Option<ClassifierFreeGuidance>,
    /// The request's generator, which serves a sequence that is not scored throughout.
    sampler: Sampler,
    committed: Vec<[u32; 2]>,
    candidates: Vec<Candidate>,
    /// How many segments are committed.
    segments: u64,
    /// Number of codes at the end of the current one.
    end: usize,
    segment: Segment,
    /// The cache holds nothing of these candidates yet.
    cold: bool,
    /// What is decoded when.
    plan: ChunkPlan,
}

/// One of the ways in which a segment could continue the sequence.
struct Candidate {
    codes: Vec<[u32; 2]>,
    sampler: Sampler,
}

impl Sequence {
    /// Before its first step.
    pub(crate) fn new(request: SequenceRequest, manifest: &Manifest) -> Self {
        let params = &request.params;
        let mut sampler = Sampler::new(params.sampling, params.seed);
        let style = request.style.as_deref();
        let (drawable, pairs) = (manifest.drawable_in(style), manifest.starts_in(style));
        let drawn = start_codes(params.start, pairs, &drawable, &mut sampler);
        let first = request.prompt.last().copied().unwrap_or(drawn);
        let total = request.conditioning.features.nrows() - request.undecoded();
        let receptive = manifest.decoder.receptive_codes;
        let mut prompt = request.prompt.clone();
        if request.resumes {
            prompt.pop();
        }
        let plan = ChunkPlan::new(total, prompt, receptive);
        let mut sequence = Self {
            guidance: ClassifierFreeGuidance::new(
                params.guidance,
                request.conditioning.features.view(),
                manifest.manners(),
            ),
            plan: if request.soon { plan.soon() } else { plan },
            request,
            drawable,
            sampler,
            committed: vec![first],
            candidates: Vec::new(),
            segments: 0,
            end: 0,
            segment: Segment::default(),
            cold: true,
        };
        sequence.begin_segment();
        sequence
    }

    /// Codes of the whole sequence, the given one included.
    fn total(&self) -> usize {
        self.request.conditioning.features.nrows()
    }

    /// Rows of the batch that it takes.
    pub(crate) fn rows(&self) -> usize {
        self.request.candidates() * self.branches()
    }

    /// With and without the music's time, if it is guided.
    fn branches(&self) -> usize {
        branches(self.request.params.guidance)
    }

    /// Whether all codes are chosen.
    pub(crate) fn has_all_codes(&self) -> bool {
        self.committed.len() >= self.total()
    }

    /// Whether it can leave the batch and come back at no cost: at a segment's start, and where the
    /// window moves, so that the cache is filled again in any case.
    pub(crate) fn can_be_preempted(&self) -> bool {
        self.cold || self.request.params.window.moves_at(self.step())
    }

    /// As at a segment's start.
    #[cfg(test)]
    pub(crate) fn chill(&mut self) {
        self.cold = true;
    }

    fn begin_segment(&mut self) {
        let committed = self.committed.len();
        let window = self.request.params.window;
        self.end = match self.request.is_scored() {
            true => segment_end(committed, self.total(), window),
            false => (committed + 1..self.total())
                .find(|&length| window.moves_at(length - 1))
                .unwrap_or_else(|| self.total()),
        };
        self.segment = Segment::default();
        self.begin_candidates();
    }

    /// Gives each a generator of its own, so that it comes out the same however many are beside it.
    fn begin_candidates(&mut self) {
        self.cold = true;
        let candidate = |sampler: Sampler| Candidate { codes: self.committed.clone(), sampler };
        if !self.request.is_scored() {
            self.candidates = vec![candidate(self.sampler.clone())];
            return;
        }
        let tried = self.segment.tried();
        self.candidates = (tried..tried + self.request.candidates())
            .map(|number| {
                let stream = self.segments << 32 | number as u64;
                candidate(self.sampler.stream(stream + 1))
            })
            .collect();
    }

    /// Makes the cache hold what the next step needs: the codes of the window before the newest,
    /// where the window moved or nothing is held yet. The sequence's rows begin at `first`.
    pub(crate) fn prefill(
        &mut self,
        model: &mut dyn CodeModel,
        first: usize,
    ) -> Result<(), EngineError> {
        let step = self.step();
        let window = self.request.params.window;
        let start = match window.at(step) {
            WindowStep::Prefill { start } => start,
            WindowStep::Extend if self.cold => window.start(step),
            WindowStep::Extend => return Ok(()),
        };
        let count = self.candidates.len();
        for branch in 0..self.branches() {
            let music = self.music(branch);
            for (number, candidate) in self.candidates.iter().enumerate() {
                let row = first + branch * count + number;
                if self.cold && number > 0 {
                    // All of them are the committed codes still.
                    model.copy(row - 1..row, row);
                    continue;
                }
                model.clear(row);
                if start < step {
                    let steps = steps(&candidate.codes, music, start..step);
                    model.prefill(row, steps)?;
                }
            }
        }
        self.cold = false;
        Ok(())
    }

    /// Index of the newest code, which is the same in all candidates.
    fn step(&self) -> usize {
        self.candidates[0].codes.len() - 1
    }

    /// The music of a branch.
    fn music(&self, branch: usize) -> ArrayView2<'_, f32> {
        match (&self.guidance, branch) {
            (Some(guidance), 1) => guidance.timeless(),
            _ => self.request.conditioning.features.view(),
        }
    }

    /// The newest step of every row.
    pub(crate) fn next_steps(&self) -> impl Iterator<Item = NextStep<'_>> {
        let step = self.step();
        (0..self.branches()).flat_map(move |branch| {
            let music = self.music(branch);
            self.candidates.iter().map(move |candidate| NextStep {
                codes: candidate.codes[step],
                // The row beside code k is k + 1: the reference drops the first row.
                music: music.index_axis_move(Axis(0), step + 1),
            })
        })
    }

    /// Chooses the next code of every candidate from its row of `logits`; the sequence's begin at
    /// `first`.
    ///
    /// # Errors
    /// [`ModelError::Run`] for logits that are no numbers.
    pub(crate) fn choose(&mut self, logits: &Logits, first: usize) -> Result<(), EngineError> {
        let count = self.candidates.len();
        logits.check_rows(first..first + self.rows())?;
        let guidance = self.guidance.as_ref();
        let form = &self.request.conditioning.form;
        for (number, Candidate { codes, sampler }) in self.candidates.iter_mut().enumerate() {
            let row = first + number;
            let favoured = form.favoured(codes);
            let choose = |half: usize| {
                let logits = [&logits.upper, &logits.lower][half];
                let drawable = &self.drawable[half];
                let favoured = favoured.map(|(pair, bonus)| (pair[half], bonus));
                let with_time = logits.row(row);
                match guidance {
                    Some(guidance) => {
                        let guided = guidance.guide(with_time, logits.row(row + count));
                        sampler.next(favouring(of_codes(drawable, guided), favoured))
                    }
                    None => {
                        let all = with_time.iter().copied();
                        sampler.next(favouring(of_codes(drawable, all), favoured))
                    }
                }
            };
            // Upper first: one generator serves both halves in this order.
            let pair = [0, 1].map(choose);
            codes.push(pair);
        }
        Ok(())
    }

    /// Commits the segment if it is whole, and begins the next.
    pub(crate) fn commit(
        &mut self,
        decoder: &SharedDecoder,
        manifest: &Manifest,
    ) -> Result<(), EngineError> {
        if self.step() + 1 < self.end {
            if !self.request.is_scored() {
                self.report(self.step() + 1);
            }
            return Ok(());
        }
        let candidates = std::mem::take(&mut self.candidates);
        let committed = self.committed.len();
        let doubtful = |candidate: &Candidate| may_freeze(&candidate.codes, committed);
        let redo = self.request.params.redo;
        if self.request.has_a_choice() || redo && candidates.iter().any(doubtful) {
            let codes: Vec<_> = candidates.iter().map(|one| &one.codes[..]).collect();
            let scores = Scorer {
                beats: &self.request.conditioning.beats,
                decoder: &mut *decoder.lock(),
                manifest,
            }
            .score(&codes, committed, self.end == self.total())?;
            for (score, candidate) in scores.into_iter().zip(candidates) {
                self.segment.consider(score, candidate.codes);
            }
            if redo && self.segment.needs(self.request.candidates()) {
                self.begin_candidates();
                return Ok(());
            }
            let best = std::mem::take(&mut self.segment).into_best();
            self.committed = best.unwrap_or_else(|| unreachable!("one was considered"));
        } else if let Some(only) = candidates.into_iter().next() {
            self.committed = only.codes;
            if !self.request.is_scored() {
                self.sampler = only.sampler;
            }
        }
        self.segments += 1;
        self.report(self.end);
        if !self.has_all_codes() {
            self.begin_segment();
        }
        Ok(())
    }

    /// Reports how many codes there are, the given one not counted.
    fn report(&self, codes: usize) {
        let given = self.request.given();
        let progress = &self.request.progress;
        progress.codes(codes - given, self.total() - given);
    }

    /// Committed codes, without the given one.
    fn own_codes(&self) -> &[[u32; 2]] {
        &self.committed[self.request.given()..]
    }

    /// The next chunk of codes that can be decoded.
    pub(crate) fn next_chunk(&mut self) -> Option<Chunk> {
        self.plan.next(&self.committed[self.request.undecoded()..])
    }

    /// The codes of the whole sequence, once there are no more chunks.
    pub(crate) fn finished_codes(&self) -> Option<Vec<[u32; 2]>> {
        self.plan.is_complete().then(|| self.own_codes().to_vec())
    }
}

/// Codes with their rows of music.
fn steps<'a>(codes: &'a [[u32; 2]], music: ArrayView2<'a, f32>, range: Range<usize>) -> Steps<'a> {
    let rows = Slice::from(range.start + 1..range.end + 1);
    Steps { codes: &codes[range], music: music.slice_axis_move(Axis(0), rows) }
}

/// The logits of some codes, ascending, out of those of all.
fn of_codes(codes: &[u32], logits: impl Iterator<Item = f32>) -> impl Iterator<Item = (u32, f32)> {
    let mut wanted = codes.iter().copied().peekable();
    (0..).zip(logits).filter(move |&(code, _)| wanted.next_if_eq(&code).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logits_of_some_codes_keep_their_codes() {
        let found: Vec<_> = of_codes(&[0, 2, 3], [0.5, 1.5, 2.5, 3.5].into_iter()).collect();
        assert_eq!(found, [(0, 0.5), (2, 2.5), (3, 3.5)]);
    }
}
