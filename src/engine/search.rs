//! Best of several candidates, phrase by phrase: of what the model would dance next, that whose beats
//! lie nearest to the music's (the reward of Eq. 15 as a choice instead of a lesson), less its share of
//! frames that stand still.

use super::{
    error::of_model,
    generator::{Dancing, Request},
    sampler::Sampler,
};
use crate::{
    Result,
    format::Codes,
    model::{Decoder, Gpt, Manifest},
    motion::{beat_meeting, dance_beats, joint_speed, slow_share},
};

/// Codes that are chosen at once: about two seconds, a bar or so.
const PHRASE: usize = 16;
/// Codes at a phrase's end that are judged with the next one: their speed is smoothed, and decoded, with
/// what follows.
const UNSETTLED: usize = 2;
/// Settled codes before those judged that are decoded with them: what is judged is near the dance, not
/// the same, as its decoder sees further; the whole of that would double the cost.
const CONTEXT: usize = 3;

/// While the best candidate has this share of slow frames, it freezes, and more are tried ..
const FREEZING: f64 = 0.1;
/// .. until there were so many: what one request may cost stays bounded.
const PATIENCE: usize = 12;

/// What candidates are judged by.
pub(crate) struct Search<'a> {
    /// Candidates for every phrase.
    pub(crate) candidates: usize,
    /// Frames of the music's beats, ascending.
    pub(crate) beats: &'a [usize],
    pub(crate) decoder: &'a mut Decoder,
    pub(crate) manifest: &'a Manifest,
}

/// What is thought of a candidate.
#[derive(Clone, Copy, Debug)]
struct Verdict {
    /// How well its beats meet the music's, 0 to 1.
    meeting: f64,
    /// Share of its frames that stand still.
    slow: f64,
}

impl Verdict {
    fn worth(self) -> f64 {
        self.meeting - self.slow
    }
}

impl Search<'_> {
    /// Generates one code pair per music row, beginning with the start pair.
    pub(crate) fn generate_codes(
        &mut self,
        gpt: &mut Gpt,
        sampler: &mut Sampler,
        request: &Request<'_>,
    ) -> Result<Codes> {
        let rows = request.music.nrows();
        let mut dance = Dancing::new(gpt, request).map_err(of_model)?;
        while dance.codes.upper.len() < rows {
            let settled = dance.codes.upper.len();
            let length = (settled + PHRASE).min(rows);
            let mut best: Option<(Verdict, Dancing)> = None;
            for tried in 0..self.candidates.max(PATIENCE) {
                let enough = |(verdict, _): &(Verdict, Dancing)| verdict.slow < FREEZING;
                if tried >= self.candidates && best.as_ref().is_some_and(enough) {
                    break;
                }
                let mut candidate = dance.clone();
                while candidate.codes.upper.len() < length {
                    candidate.step(gpt, sampler, request).map_err(of_model)?;
                }
                let verdict = self.judge(&candidate.codes, settled, length == rows, request)?;
                let better = |(least, _): &(Verdict, Dancing)| verdict.worth() > least.worth();
                if best.as_ref().is_none_or(better) {
                    best = Some((verdict, candidate));
                }
            }
            if let Some((_, chosen)) = best {
                dance = chosen;
            }
            request.progress.codes(length, rows);
        }
        Ok(dance.codes)
    }

    /// Judges the frames that the codes from `settled` on decide about.
    fn judge(
        &mut self,
        codes: &Codes,
        settled: usize,
        ends: bool,
        request: &Request<'_>,
    ) -> Result<Verdict> {
        let per_code = self.manifest.frames_per_code;
        let from = settled.saturating_sub(UNSETTLED);
        let to = codes.upper.len() - if ends { 0 } else { UNSETTLED };
        let first = from.saturating_sub(CONTEXT);
        let decoded = self
            .decoder
            .decode(
                codes.upper.get(first..).unwrap_or_default(),
                codes.lower.get(first..).unwrap_or_default(),
                request.cancel,
            )
            .map_err(of_model)?;
        let motion = self.manifest.motion_frame.into_world(decoded)?;
        let speed = joint_speed(motion.view());
        let beats = dance_beats(&speed).into_iter();
        let dance: Vec<usize> = beats.map(|frame| first * per_code + frame).collect();
        let judged = from * per_code..to * per_code;
        let judged_speed: Vec<f64> = speed
            .into_iter()
            .skip(judged.start - first * per_code)
            .take(judged.len())
            .collect();
        Ok(Verdict {
            slow: slow_share(&judged_speed, f64::from(self.manifest.fps)),
            meeting: beat_meeting(self.beats, &dance, judged).unwrap_or(0.0),
        })
    }
}
