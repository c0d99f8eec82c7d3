//! The options of a generation: one list that the query, the form, the command line, `GET /info`
//! and the OpenAPI document are all made of.

mod accepts;
mod args;
mod table;
mod takes;

pub(crate) use self::accepts::Accepts;
use self::table::PositionsOption;
pub use self::table::RequestOptions;
pub(crate) use self::table::{OPTIONS, OptionSpec, Section};
pub use self::takes::{Take, Takes};
use crate::{
    audio::AudioRange,
    engine::GenerationOptions,
    formats::{
        Codes, FormatError, GeneratedMotion, JsonOptions, LoopOptions, MOST_LOOP_DANCES,
        OutputFormat, PositionsSource, WriteOptions,
    },
};

/// An option that is not accepted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("option `{name}`: {problem}")]
pub struct OptionError {
    /// The option, as far as it was named.
    pub name: String,
    /// What was wrong and what is accepted.
    pub problem: String,
}

impl OptionSpec {
    /// Returns whether the option only says how a result is written.
    pub(crate) fn is_output(&self) -> bool {
        matches!(self.section, Section::Output | Section::HttpOutput)
    }

    /// Checks a value.
    ///
    /// # Errors
    /// What was wrong and what is accepted.
    fn check(&self, text: &str) -> Result<(), String> {
        match text.len() <= self.accepts.longest() && self.accepts.admits(text) {
            true => Ok(()),
            false => Err(format!("got {:?}, expected {}", shorten(text), self.accepts)),
        }
    }
}

impl RequestOptions {
    /// Sets one option.
    ///
    /// # Errors
    /// [`OptionError`] names the option and what is accepted.
    pub(crate) fn set(&mut self, name: &str, text: &str) -> Result<(), OptionError> {
        let refuse = |problem: String| Err(OptionError { name: shorten(name), problem });
        let Some(option) = option_named(name) else {
            return refuse(format!("there is no such option; there are {}", option_names()));
        };
        if self.given.iter().any(|(given, _)| *given == option.name) {
            return refuse("it was given more than once".to_owned());
        }
        self.given.push((option.name, text.to_owned()));
        match option.check(text) {
            Ok(()) if (option.read)(self, text) => Ok(()),
            Ok(()) => refuse(format!("got {text:?}, expected {}", option.accepts)),
            Err(problem) => refuse(problem),
        }
    }

    /// The options that were given, as texts that `set` takes again.
    #[must_use]
    pub fn given(&self) -> &[(&'static str, String)] {
        &self.given
    }

    /// Returns how a result is written.
    #[must_use]
    pub fn writing(&self) -> WriteOptions {
        WriteOptions {
            json: JsonOptions {
                rotations: self.include.is_some(),
                encoding: self.encoding.unwrap_or_default(),
            },
            bvh_unit: self.bvh_unit.unwrap_or_default(),
            skeleton: self.skeleton.unwrap_or_default(),
            mannequin: self.mannequin.unwrap_or(true),
        }
    }

    /// Whether a dance on a caller's character holds its feet where they stand.
    #[must_use]
    pub fn plants_feet(&self) -> bool {
        let made = self.generation(OutputFormat::default());
        made.clean && made.root_motion
    }

    fn wants_bars(&self) -> bool {
        self.bars.is_some() || self.r#loop == Some(true)
    }

    /// Which whole bars are wanted, if any.
    pub(crate) fn bars_wanted(&self) -> Option<LoopOptions> {
        const BARS: usize = 4;
        self.wants_bars().then(|| LoopOptions {
            bars: self.bars.unwrap_or(BARS),
            closes: self.r#loop.unwrap_or(true),
            planted: self.plants_feet(),
            // Given codes are one dance.
            dances: self.codes.as_ref().map(|_| 1).or(self.candidates),
        })
    }

    /// As how many dances of one candidate these options count at most.
    pub(crate) fn most_candidates(&self) -> usize {
        let own = if self.wants_bars() { MOST_LOOP_DANCES } else { 1 };
        self.candidates.unwrap_or(own).max(1)
    }

    /// The longest part of a song in seconds that these options ask for, if they say.
    pub(crate) fn longest_seconds(&self) -> Option<f64> {
        self.duration_s
    }

    /// The number of code pairs that are given, if they are.
    pub(crate) fn given_codes(&self) -> Option<usize> {
        self.codes.as_ref().map(|codes| codes.upper.len())
    }

    /// The given codes as a text that means the same to a dance of at most `most` of them: no
    /// longer than it needs be, however they were written.
    pub(crate) fn shortest_codes(&self, most: usize) -> Option<String> {
        let first = |half: &[u32]| half.iter().copied().take(most).collect();
        let Codes { upper, lower } = self.codes.as_ref()?;
        let codes = Codes { upper: first(upper), lower: first(lower) };
        serde_json::to_string(&codes).ok()
    }

    /// These options for a dance of `codes`.
    #[must_use]
    pub fn with_codes(self, codes: Codes) -> Self {
        Self { codes: Some(codes), ..self }
    }

    /// These options, with the output options of `other` in the place of their own.
    ///
    /// # Errors
    /// [`OptionError`] if `other` asks for another motion.
    pub(crate) fn written_as(&self, other: &Self) -> Result<Self, OptionError> {
        let outputs = || OPTIONS.iter().filter(|option| option.is_output());
        let is_output = |name: &str| outputs().any(|output| output.name == name);
        if let Some((name, _)) = other.given.iter().find(|(name, _)| !is_output(name)) {
            let outputs = names(outputs());
            return Err(OptionError {
                name: (*name).to_owned(),
                problem: format!("the motion exists already; what can be chosen now is {outputs}"),
            });
        }
        Ok(Self {
            format: other.format.or(self.format),
            include: other.include.or(self.include),
            encoding: other.encoding.or(self.encoding),
            bvh_unit: other.bvh_unit.or(self.bvh_unit),
            skeleton: other.skeleton.or(self.skeleton),
            mannequin: other.mannequin.or(self.mannequin),
            ..self.clone()
        })
    }

    /// Writes `dance` in `format`.
    ///
    /// # Errors
    /// As [`OutputFormat::write`].
    pub(crate) fn write(
        &self,
        dance: &GeneratedMotion,
        format: OutputFormat,
    ) -> Result<Vec<u8>, FormatError> {
        format.write(dance, &self.writing())
    }

    /// The engine's part of the options, for a result in `format`.
    #[must_use]
    pub fn generation(&self, format: OutputFormat) -> GenerationOptions {
        let sampling = self.sampling();
        let positions = self.positions.map_or(sampling.positions, |PositionsOption(from)| from);
        GenerationOptions {
            codes: self.codes.clone(),
            range: AudioRange {
                offset_s: self.offset_s.unwrap_or_default(),
                duration_s: self.duration_s,
            },
            fps: self.fps.unwrap_or(sampling.fps),
            root_motion: self.root_motion.unwrap_or(sampling.root_motion),
            mirror: self.mirror.unwrap_or(sampling.mirror),
            // The decoder's own positions are as decoded.
            clean: self.clean.unwrap_or(positions != PositionsSource::Decoder),
            positions,
            music: self.music.unwrap_or(format == OutputFormat::Json) || self.wants_bars(),
            // Those of a loop are whole dances.
            candidates: sampling.candidates.filter(|_| !self.wants_bars()),
            ..sampling
        }
    }
}

/// Most bytes that are read of the value of the option of this name.
pub(crate) fn longest_value(name: &str) -> usize {
    option_named(name).map_or(accepts::LONGEST_VALUE, |option| option.accepts.longest())
}

/// The option of this name, if there is one.
pub(crate) fn option_named(name: &str) -> Option<&'static OptionSpec> {
    OPTIONS.iter().find(|option| option.name == name)
}

/// The names of all options.
pub(crate) fn option_names() -> String {
    names(OPTIONS.iter())
}

fn names<'a>(options: impl Iterator<Item = &'a OptionSpec>) -> String {
    let names: Vec<&str> = options.map(|option| option.name).collect();
    names.join(", ")
}

/// A caller's text, short enough to be repeated in an answer.
pub(crate) fn shorten(text: &str) -> String {
    const SHOWN: usize = 60;
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}..", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        engine::MAX_SEED,
        formats::{BvhUnit, Codes, Continuation, Encoding, TargetSkeleton},
        model::WindowKind,
    };

    fn query(text: &str) -> Result<RequestOptions, String> {
        let mut options = RequestOptions::default();
        for pair in text.split('&').filter(|pair| !pair.is_empty()) {
            let (name, value) = pair.split_once('=').unwrap();
            options.set(name, value).map_err(|error| error.to_string())?;
        }
        Ok(options)
    }

    #[test]
    fn every_option_is_read() {
        let options = query(
            "format=bvh&fps=24&seed=9007199254740991&temperature=0.5&top_k=7\
             &style=krump&energy=0.75&guidance=2.5&candidates=3&redo=false&form=true\
             &start_upper=1&start_lower=2\
             &continue_from=AgEjRWcAAABAPwAAAAAAAAAAAAEAAgA&window=sliding&hop=15&offset_s=1.5\
             &duration_s=2e1&root_motion=false&mirror=true&clean=false&positions=decoder\
             &bars=8&loop=false&music=true&include=rotations&encoding=base64&bvh_unit=m\
             &skeleton=vrm\
             &mannequin=false&codes=[[4,5]]",
        )
        .unwrap();
        let (upper, lower) = (vec![1], vec![2]);
        let tail = Continuation::new("01234567", Codes { upper, lower }, [0.0; 2], 0.75);
        assert_eq!(options.given.len(), OPTIONS.len());
        assert_eq!(options.format, Some(OutputFormat::Bvh));
        assert_eq!(
            options.writing(),
            WriteOptions {
                json: JsonOptions { rotations: true, encoding: Encoding::Base64 },
                bvh_unit: BvhUnit::Metre,
                skeleton: TargetSkeleton::Vrm,
                mannequin: false,
            }
        );
        assert_eq!(RequestOptions::default().writing(), WriteOptions::default());
        assert_eq!(
            options.generation(OutputFormat::Bvh),
            GenerationOptions {
                codes: Some(Codes { upper: vec![4], lower: vec![5] }),
                seed: Some(MAX_SEED),
                temperature: Some(0.5),
                top_k: Some(7),
                style: Some("krump".into()),
                energy: Some(0.75),
                guidance: Some(2.5),
                // With bars they are whole dances.
                candidates: None,
                redo: Some(false),
                form: Some(true),
                start_upper: Some(1),
                start_lower: Some(2),
                continue_from: Some(tail),
                window: Some(WindowKind::Sliding),
                hop: Some(15),
                range: AudioRange { offset_s: 1.5, duration_s: Some(20.0) },
                fps: 24,
                root_motion: false,
                mirror: true,
                clean: false,
                positions: PositionsSource::Decoder,
                music: true,
            }
        );
    }

    #[test]
    fn music_is_found_for_json_and_not_for_bvh() {
        let options = query("").unwrap();
        assert!(options.generation(OutputFormat::Json).music);
        assert!(!options.generation(OutputFormat::Bvh).music);
        let options = query("music=false").unwrap();
        assert!(!options.generation(OutputFormat::Json).music);
        // Bars are the music's.
        let options = query("music=false&bars=2").unwrap();
        assert!(options.generation(OutputFormat::Bvh).music);
    }

    #[test]
    fn bars_close_to_a_loop_unless_they_are_not_to() {
        let wanted = |text: &str| {
            let bars = query(text).unwrap().bars_wanted();
            bars.map(|LoopOptions { bars, closes, planted, .. }| (bars, closes, planted))
        };
        assert_eq!(wanted(""), None);
        assert_eq!(wanted("loop=false"), None);
        assert_eq!(wanted("bars=8"), Some((8, true, true)));
        assert_eq!(wanted("loop=true"), Some((4, true, true)));
        assert_eq!(wanted("bars=2&loop=false&clean=false"), Some((2, false, false)));
    }

    #[test]
    fn candidates_of_a_loop_are_whole_dances() {
        let wanted = |text: &str| {
            let options = query(text).unwrap();
            let dances = options.bars_wanted().and_then(|wanted| wanted.dances);
            let segments = options.generation(OutputFormat::Json).candidates;
            (dances, segments, options.most_candidates())
        };
        assert_eq!(wanted(""), (None, None, 1));
        assert_eq!(wanted("candidates=3"), (None, Some(3), 3));
        assert_eq!(wanted("candidates=3&bars=2"), (Some(3), None, 3));
        assert_eq!(wanted("loop=true"), (None, None, MOST_LOOP_DANCES));
        assert_eq!(wanted("loop=true&codes=[[4,5]]"), (Some(1), None, MOST_LOOP_DANCES));
    }

    #[test]
    fn motion_is_clean_unless_it_is_the_decoders() {
        let made = |text: &str| {
            let options = query(text).unwrap().generation(OutputFormat::Json);
            (options.clean, options.positions)
        };
        assert_eq!(made(""), (true, PositionsSource::ForwardKinematics));
        assert_eq!(made("clean=false&positions=fk"), (false, PositionsSource::ForwardKinematics));
        assert_eq!(made("positions=decoder"), (false, PositionsSource::Decoder));
        // Which the engine refuses.
        assert_eq!(made("positions=decoder&clean=true"), (true, PositionsSource::Decoder));
    }

    #[test]
    fn a_wrong_option_is_refused_with_what_is_accepted() {
        let long = format!("seed={}", "1".repeat(10_000));
        let codes = format!("codes=[{}[1,2]]", "[1,2],".repeat(accepts::LONGEST_CODES / 6));
        for (text, wanted) in [
            ("fps=25", "option `fps`: got \"25\", expected one of 20, 24, 30, 60"),
            ("seed=-1", "expected a whole number from 0 to 9007199254740991"),
            ("seed=9007199254740992", "option `seed`"),
            ("seed=", "option `seed`: got \"\""),
            ("temperature=warm", "expected a number from 0 to 10"),
            ("offset_s=-1", "expected a number from 0 to 1000000"),
            ("offset_s=1e308", "expected a number from 0 to 1000000"),
            ("temperature=NaN", "option `temperature`"),
            ("temperature=1e300", "option `temperature`"),
            ("temperature=-0.1", "option `temperature`"),
            ("guidance=11", "option `guidance`"),
            ("energy=1.5", "option `energy`: got \"1.5\", expected a number from 0 to 1"),
            ("style=", "option `style`: got \"\", expected auto, or a style of the model"),
            ("candidates=17", "`candidates`: got \"17\", expected a whole number from 1 to 16"),
            ("top_k=0", "expected a whole number from 1 to"),
            ("start_upper=4294967296", "option `start_upper`"),
            ("duration_s=0", "expected a number above 0"),
            ("duration_s=inf", "option `duration_s`"),
            ("root_motion=maybe", "expected true or false"),
            ("clean=maybe", "expected true or false"),
            ("positions=raw", "expected one of fk, decoder"),
            ("include=everything", "expected rotations"),
            ("seed=1&seed=1", "option `seed`: it was given more than once"),
            ("sede=1", "there is no such option; there are seed, temperature, top_k,"),
            ("continue_from=x", "expected the `tail` that came with an earlier dance"),
            ("format=mp4", "expected one of json, bvh, glb, vrma, fbx, vmd, npz"),
            ("skeleton=maya", "expected one of smpl, mixamo, vrm, unreal"),
            (&long, "1.."),
            (&codes, "option `codes`: got \"[[1,2],"),
            ("codes=[1,2]", "expected JSON of pose codes: {\"upper\": [..], \"lower\": [..]}"),
        ] {
            let problem = query(text).unwrap_err();
            assert!(problem.contains(wanted), "{text}: {problem}");
        }
    }
}
