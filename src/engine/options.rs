//! What a caller may choose about a generation.

use ndarray::ArrayView2;

use super::{
    EngineError,
    guidance::branches,
    sampler::{MAX_SEED, Sampling},
    window::Window,
};
use crate::{
    audio::AudioRange,
    formats::{Codes, Continuation},
    model::{
        MAX_CANDIDATES, MAX_GUIDANCE, MAX_TEMPERATURE, Manifest, Manner, NO_STYLE, StyleClassifier,
        Vocabulary, WindowKind,
    },
    motion::{self, PositionsSource},
};

/// What a caller may choose about a generation (API.md). `None` means the manifest's default.
#[derive(Clone, Debug, PartialEq)]
pub struct GenerationOptions {
    /// The codes of the dance; chosen by the model if absent.
    pub codes: Option<Codes>,
    /// Seed of the one generator of this request; drawn if absent.
    pub seed: Option<u64>,
    /// 0 takes the most likely code.
    pub temperature: Option<f32>,
    /// Draw from this many most likely codes.
    pub top_k: Option<usize>,
    /// One of the model's styles; `auto`, as where it is absent, takes that of the music, `mixed`
    /// none.
    pub style: Option<String>,
    /// Energy of the dance within its style, from 0 to 1; as the model likes where it is absent.
    pub energy: Option<f32>,
    /// How strongly the dance follows the music's time and the style: 1 as the model predicts, more
    /// exaggerates both, less hides them; other than 1 costs twice as much.
    pub guidance: Option<f32>,
    /// Candidates for every segment, two to four seconds. The best is kept: its beats lie nearest
    /// to the music's, and few of its frames stand still.
    pub candidates: Option<usize>,
    /// Whether a segment in which the dancer stands still (of several candidates also: goes to the
    /// ground) is generated again, up to three times and with at most 12 candidates in all. Absent:
    /// as the model says, and where there are several candidates.
    pub redo: Option<bool>,
    /// Whether the choreography of a section returns where the song's section does. Feature rows
    /// carry no sections.
    pub form: Option<bool>,
    /// First upper pose code; drawn from the manifest's list if absent.
    pub start_upper: Option<u32>,
    /// First lower pose code; drawn from the manifest's list if absent.
    pub start_lower: Option<u32>,
    /// How the window of past codes moves.
    pub window: Option<WindowKind>,
    /// Codes kept when a hop window shrinks.
    pub hop: Option<usize>,
    /// The end of an earlier dance, which this one continues; its codes take the place of start
    /// codes.
    pub continue_from: Option<Continuation>,
    /// Which part of the song.
    pub range: AudioRange,
    /// Frames per second of the result: 20, 24, 30 or 60.
    pub fps: u32,
    /// Whether the dancer travels; `false` holds x and z of the root at 0 and keeps y.
    pub root_motion: bool,
    /// Whether left and right are exchanged.
    pub mirror: bool,
    /// Whether the motion is cleaned: feet held in place, joints within their limits, no jitter.
    pub clean: bool,
    /// Where positions come from; the decoder's own exist at its frame rate and without clean-up.
    pub positions: PositionsSource,
    /// Whether to find the music's tempo, beats and bars.
    pub music: bool,
}

/// The options of one sequence, with the manifest's defaults filled in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SamplingParams {
    /// How the next code is chosen.
    pub(crate) sampling: Sampling,
    /// How strongly the music's time is followed.
    pub(crate) guidance: f32,
    /// Candidates for every segment; 1 where they would not differ.
    pub(crate) candidates: usize,
    /// Whether a segment is generated again where it stands still.
    pub(crate) redo: bool,
    /// Seed of the request's generator.
    pub(crate) seed: u64,
    /// Given start codes, upper and lower.
    pub(crate) start: [Option<u32>; 2],
    /// How the window of past codes moves.
    pub(crate) window: Window,
}

impl Default for GenerationOptions {
    fn default() -> Self {
        Self {
            codes: None,
            seed: None,
            temperature: None,
            top_k: None,
            style: None,
            energy: None,
            guidance: None,
            candidates: None,
            redo: None,
            form: None,
            start_upper: None,
            start_lower: None,
            continue_from: None,
            window: None,
            hop: None,
            range: AudioRange::default(),
            fps: 60,
            root_motion: true,
            mirror: false,
            clean: true,
            positions: PositionsSource::ForwardKinematics,
            music: false,
        }
    }
}

impl GenerationOptions {
    /// These options for the model of `manifest` and a batch of so many rows.
    pub(crate) fn resolve(&self, manifest: &Manifest, batch: usize, seed: u64) -> SamplingParams {
        let defaults = manifest.sampling;
        SamplingParams {
            sampling: Sampling {
                temperature: self.temperature.unwrap_or(defaults.temperature),
                top_k: self.top_k.or(defaults.top_k),
            },
            guidance: self.guidance.unwrap_or(defaults.guidance),
            candidates: self.candidates(manifest, batch),
            redo: self.redo(manifest, batch),
            seed,
            start: [self.start_upper, self.start_lower],
            window: Window::new(
                self.window.unwrap_or(defaults.window),
                self.hop.unwrap_or(defaults.hop),
                manifest.gpt.context,
            ),
        }
    }

    /// Checks every option against the model of `manifest`, of which `batch` sequences share a
    /// step.
    ///
    /// # Errors
    /// [`EngineError::Option`] names the first option that does not fit, and what does.
    pub fn check(&self, manifest: &Manifest, batch: usize) -> Result<(), EngineError> {
        self.check_sampling(manifest)?;
        self.check_manner(manifest)?;
        self.check_batch(manifest, batch)?;
        self.check_start(manifest.vocabulary)?;
        self.check_tail(manifest)?;
        self.check_codes(manifest.vocabulary)?;
        if !motion::FRAME_RATES.contains(&self.fps) {
            let rates = motion::FRAME_RATES.map(|rate| rate.to_string()).join(", ");
            return refuse("fps", format!("{} is not one of {rates}", self.fps));
        }
        let is_decoded = self.fps == manifest.fps && !self.clean;
        if self.positions == PositionsSource::Decoder && !is_decoded {
            let fps = manifest.fps;
            let problem = format!(
                "the decoder's own positions exist at {fps} frames a second and without clean-up: \
                 choose fps={fps} and clean=false, or positions=fk"
            );
            return refuse("positions", problem);
        }
        check_range(self.range)
    }

    /// How codes are drawn.
    fn check_sampling(&self, manifest: &Manifest) -> Result<(), EngineError> {
        if let Some(seed) = self.seed.filter(|&seed| seed > MAX_SEED) {
            let problem = format!("{seed} is too large, the largest is {MAX_SEED}");
            return refuse("seed", problem);
        }
        let numbers = [
            ("temperature", self.temperature, MAX_TEMPERATURE),
            ("guidance", self.guidance, MAX_GUIDANCE),
        ];
        for (name, number, most) in numbers {
            if let Some(number) = number.filter(|number| !(0.0..=most).contains(number)) {
                return refuse(name, format!("{number} is not between 0 and {most}"));
            }
        }
        let Vocabulary { upper, lower, .. } = manifest.vocabulary;
        check_between("candidates", self.candidates, 1, MAX_CANDIDATES)?;
        check_between("top_k", self.top_k, 1, upper.max(lower))?;
        check_between("hop", self.hop, 1, manifest.gpt.context)
    }

    /// Style and energy must be known to the model.
    fn check_manner(&self, manifest: &Manifest) -> Result<(), EngineError> {
        let known = |style: &&String| !accepted_styles(&manifest.styles).contains(&style.as_str());
        if let Some(style) = self.style.as_ref().filter(known) {
            if manifest.styles.is_empty() {
                return refuse("style", format!("{style:?}: this model has no styles"));
            }
            let accepted = accepted_styles(&manifest.styles).join(", ");
            return refuse("style", format!("{style:?} is not one of {accepted}"));
        }
        match self.energy {
            Some(_) if !manifest.energy => {
                refuse("energy", "this model cannot be asked for more or less of it".into())
            }
            Some(energy) if !(0.0..=1.0).contains(&energy) => {
                refuse("energy", format!("{energy} is not between 0 and 1"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the manner that is asked for, and the name of its style, to music of these rows;
    /// no name from a model without styles.
    pub(super) fn manner(
        &self,
        manifest: &Manifest,
        classifier: Option<&StyleClassifier>,
        music: ArrayView2<'_, f32>,
    ) -> (Manner, Option<String>) {
        let styles = &manifest.styles;
        let [auto, mixed] = NO_STYLE;
        let style = match self.style.as_deref().unwrap_or(auto) {
            asked if asked == auto => classifier.and_then(|classifier| classifier.style(music)),
            asked => styles.iter().position(|style| style == asked),
        };
        let name = style.and_then(|style| styles.get(style)).map_or(mixed, String::as_str);
        let manner = Manner { style, energy: self.energy };
        (manner, (!styles.is_empty()).then(|| name.to_owned()))
    }

    /// Sequences that are computed side by side must fit into the batch.
    fn check_batch(&self, manifest: &Manifest, batch: usize) -> Result<(), EngineError> {
        let branches = branches(self.guidance.unwrap_or(manifest.sampling.guidance));
        if branches > batch {
            return refuse(
                "guidance",
                format!(
                    "other than 1 it needs two dances side by side; this server's batch is {batch}"
                ),
            );
        }
        if self.candidates(manifest, batch) * branches > batch {
            return refuse(
                "candidates",
                format!(
                    "at most {} fit into this server's batch of {batch}, {branches} of it for each",
                    batch / branches
                ),
            );
        }
        Ok(())
    }

    fn check_start(&self, vocabulary: Vocabulary) -> Result<(), EngineError> {
        let code = |start: Option<u32>| start.map(|code| code as usize);
        let (upper, lower) = (code(self.start_upper), code(self.start_lower));
        check_between("start_upper", upper, 0, vocabulary.upper - 1)?;
        check_between("start_lower", lower, 0, vocabulary.lower - 1)
    }

    /// Candidates for every segment: as many as asked for, else the model's own, as far as `batch`
    /// has room for them; one where they would not differ.
    pub(super) fn candidates(&self, manifest: &Manifest, batch: usize) -> usize {
        let defaults = manifest.sampling;
        if !self.has_chance(manifest) {
            return 1;
        }
        let room = batch / branches(self.guidance.unwrap_or(defaults.guidance));
        let own = defaults.candidates.min(room.max(1));
        self.candidates.unwrap_or(own)
    }

    /// Whether segments are generated again where they stand still.
    fn redo(&self, manifest: &Manifest, batch: usize) -> bool {
        let own = manifest.sampling.redo || self.candidates(manifest, batch) > 1;
        self.redo.unwrap_or(own) && self.has_chance(manifest)
    }

    /// Whether other random numbers could lead to another dance.
    fn has_chance(&self, manifest: &Manifest) -> bool {
        let defaults = manifest.sampling;
        let temperature = self.temperature.unwrap_or(defaults.temperature);
        temperature != 0.0 && self.top_k.or(defaults.top_k) != Some(1)
    }

    /// Given codes must be the model's, in pairs, and leave nothing to draw.
    fn check_codes(&self, vocabulary: Vocabulary) -> Result<(), EngineError> {
        let Some(Codes { upper, lower }) = &self.codes else {
            return Ok(());
        };
        if upper.is_empty() || upper.len() != lower.len() {
            let problem = format!(
                "there are {} upper and {} lower codes, expected pairs of them, at least one",
                upper.len(),
                lower.len()
            );
            return refuse("codes", problem);
        }
        for (half, codes, size) in
            [("upper", upper, vocabulary.upper), ("lower", lower, vocabulary.lower)]
        {
            if let Some(place) = codes.iter().position(|&code| code as usize >= size) {
                let problem = format!(
                    "number {} of the {half} codes is {}, and this model has 0 to {}",
                    place + 1,
                    codes[place],
                    size - 1
                );
                return refuse("codes", problem);
            }
        }
        let drawing = [
            ("temperature", self.temperature.is_some()),
            ("top_k", self.top_k.is_some()),
            ("style", self.style.is_some()),
            ("energy", self.energy.is_some()),
            ("guidance", self.guidance.is_some()),
            ("candidates", self.candidates.is_some()),
            ("redo", self.redo.is_some()),
            ("form", self.form.is_some()),
            ("start_upper", self.start_upper.is_some()),
            ("start_lower", self.start_lower.is_some()),
            ("window", self.window.is_some()),
            ("hop", self.hop.is_some()),
        ];
        match drawing.into_iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) => {
                let problem = "it says how codes are chosen, and `codes` gives them: leave out one";
                refuse(name, problem.to_owned())
            }
            None => Ok(()),
        }
    }

    /// Codes of a tail must be the model's, and leave no choice of others.
    fn check_tail(&self, manifest: &Manifest) -> Result<(), EngineError> {
        let vocabulary = manifest.vocabulary;
        let Some(tail) = &self.continue_from else {
            return Ok(());
        };
        let joints = manifest.skeleton.joints.len();
        let known = |half: &[u32], codes: usize| half.iter().all(|&code| (code as usize) < codes);
        let problem = if self.start_upper.is_some() || self.start_lower.is_some() {
            "start_upper and start_lower say something else: give either"
        } else if tail.codes.upper.is_empty() || tail.codes.upper.len() != tail.codes.lower.len() {
            "it holds no pairs of pose codes"
        } else if !known(&tail.codes.upper, vocabulary.upper)
            || !known(&tail.codes.lower, vocabulary.lower)
        {
            "it holds a pose code that this model does not have"
        } else if usize::from(tail.shown) >= manifest.frames_per_code {
            "it ends beyond its last pose code"
        } else if tail.seam.as_ref().is_some_and(|seam| seam.rotations.len() != joints) {
            "its pose has other joints than this model"
        } else {
            return Ok(());
        };
        refuse("continue_from", problem.into())
    }
}

/// Returns what the option `style` accepts of a model with these styles.
pub(crate) fn accepted_styles(styles: &[String]) -> Vec<&str> {
    let no_style = match styles {
        [] => &NO_STYLE[..1],
        _ => &NO_STYLE[..],
    };
    no_style.iter().copied().chain(styles.iter().map(String::as_str)).collect()
}

fn refuse(name: &'static str, problem: String) -> Result<(), EngineError> {
    Err(EngineError::Option { name, problem })
}

fn check_range(range: AudioRange) -> Result<(), EngineError> {
    let AudioRange { offset_s, duration_s } = range;
    if !offset_s.is_finite() || offset_s < 0.0 {
        let problem = format!("{offset_s} is not a time in seconds from 0 on");
        return refuse("offset_s", problem);
    }
    match duration_s.filter(|duration| !duration.is_finite() || *duration <= 0.0) {
        Some(d) => refuse("duration_s", format!("{d} is not a length in seconds above 0")),
        None => Ok(()),
    }
}

fn check_between(
    name: &'static str,
    value: Option<usize>,
    lowest: usize,
    highest: usize,
) -> Result<(), EngineError> {
    match value.filter(|value| !(lowest..=highest).contains(value)) {
        Some(value) => refuse(name, format!("{value} is not between {lowest} and {highest}")),
        None => Ok(()),
    }
}
