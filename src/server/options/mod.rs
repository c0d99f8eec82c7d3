//! The options of a generation: one table that the parser, its error messages and the OpenAPI
//! document are all made of.

mod accepts;
mod document;
mod table;

pub(crate) use document::{AudioFile, GenerateForm};

use self::table::OPTIONS;
use super::error::ServerError;
use crate::{
    audio::AudioRange,
    engine::GenerationOptions,
    formats::{
        BvhUnit, Continuation, Encoding, FormatError, GeneratedMotion, JsonOptions, OutputFormat,
    },
    model::WindowKind,
};

/// Longest option value that is looked at, in bytes.
pub(crate) const LONGEST_VALUE: usize = 256;
/// Formats of later versions.
const FORMATS_NOT_YET: [&str; 1] = ["glb"];

/// What a request asks for. `None` takes the default, which is the model's own where it has one.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RequestOptions {
    pub(crate) format: Option<OutputFormat>,
    fps: Option<u32>,
    seed: Option<u64>,
    temperature: Option<f32>,
    top_k: Option<usize>,
    guidance: Option<f32>,
    candidates: Option<usize>,
    redo: Option<bool>,
    start_upper: Option<u32>,
    start_lower: Option<u32>,
    continue_from: Option<Continuation>,
    window: Option<WindowKind>,
    hop: Option<usize>,
    offset_s: Option<f64>,
    duration_s: Option<f64>,
    root_motion: Option<bool>,
    music: Option<bool>,
    rotations: bool,
    encoding: Option<Encoding>,
    bvh_unit: Option<BvhUnit>,
    given: Vec<&'static str>,
}

impl RequestOptions {
    /// Takes one option, from wherever it came.
    ///
    /// # Errors
    /// [`ServerError::Option`] names the option and what is accepted.
    pub(crate) fn set(&mut self, name: &str, text: &str) -> Result<(), ServerError> {
        let refuse = |problem: String| {
            Err(ServerError::Option {
                name: shorten(name),
                problem,
            })
        };
        let Some(option) = OPTIONS.iter().find(|option| option.name == name) else {
            let names: Vec<&str> = OPTIONS.iter().map(|option| option.name).collect();
            return refuse(format!(
                "there is no such option; there are {}",
                names.join(", ")
            ));
        };
        if self.given.contains(&option.name) {
            return refuse("it was given more than once".to_owned());
        }
        self.given.push(option.name);
        if option.name == "format" && FORMATS_NOT_YET.contains(&text) {
            return refuse(format!(
                "{text} is not available yet in this version, expected {}",
                option.accepts
            ));
        }
        if text.len() > LONGEST_VALUE || !option.accepts.admits(text) || !(option.read)(self, text)
        {
            return refuse(format!(
                "got {:?}, expected {}",
                shorten(text),
                option.accepts
            ));
        }
        Ok(())
    }

    /// Takes all options of a query string.
    ///
    /// # Errors
    /// As [`RequestOptions::set`].
    pub(crate) fn from_query(uri: &axum::http::Uri) -> Result<Self, ServerError> {
        let mut options = Self::default();
        let pairs = axum::extract::Query::<Vec<(String, String)>>::try_from_uri(uri)
            .map_err(|rejection| ServerError::Option {
                name: "query".to_owned(),
                problem: rejection.body_text(),
            })?
            .0;
        for (name, text) in pairs {
            options.set(&name, &text)?;
        }
        Ok(options)
    }

    /// How JSON is written.
    pub(crate) fn json(&self) -> JsonOptions {
        JsonOptions {
            rotations: self.rotations,
            encoding: self.encoding.unwrap_or_default(),
        }
    }

    /// The most seconds of audio that can be asked for by these options, if they say.
    pub(crate) fn longest_seconds(&self) -> Option<f64> {
        self.duration_s
    }

    /// These options, but written as `other` asks for.
    ///
    /// # Errors
    /// [`ServerError::Option`] if `other` asks for another dance.
    pub(crate) fn written_as(&self, other: &Self) -> Result<Self, ServerError> {
        const WRITTEN: [&str; 4] = ["format", "include", "encoding", "bvh_unit"];
        if let Some(name) = other.given.iter().find(|name| !WRITTEN.contains(name)) {
            return Err(ServerError::Option {
                name: (*name).to_owned(),
                problem: format!(
                    "the dance is made already; what can be chosen now is {}",
                    WRITTEN.join(", ")
                ),
            });
        }
        Ok(Self {
            format: other.format.or(self.format),
            rotations: other.rotations || self.rotations,
            encoding: other.encoding.or(self.encoding),
            bvh_unit: other.bvh_unit.or(self.bvh_unit),
            ..self.clone()
        })
    }

    /// Writes `dance` as asked for.
    pub(crate) fn write(
        &self,
        dance: &GeneratedMotion,
        format: OutputFormat,
    ) -> Result<Vec<u8>, FormatError> {
        format.write(dance, &self.json(), self.bvh_unit.unwrap_or_default())
    }

    /// The engine's part of the options.
    pub(crate) fn generation(&self, format: OutputFormat) -> GenerationOptions {
        let default = GenerationOptions::default();
        GenerationOptions {
            seed: self.seed,
            temperature: self.temperature,
            top_k: self.top_k,
            guidance: self.guidance,
            candidates: self.candidates,
            redo: self.redo,
            start_upper: self.start_upper,
            start_lower: self.start_lower,
            continue_from: self.continue_from.clone(),
            window: self.window,
            hop: self.hop,
            range: AudioRange {
                offset_s: self.offset_s.unwrap_or_default(),
                duration_s: self.duration_s,
            },
            fps: self.fps.unwrap_or(default.fps),
            root_motion: self.root_motion.unwrap_or(default.root_motion),
            music: self.music.unwrap_or(format == OutputFormat::Json),
        }
    }
}

/// What a stranger sent, short enough to be repeated to them.
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
    use crate::{engine::MAX_SEED, formats::Codes};

    fn query(text: &str) -> Result<RequestOptions, String> {
        let uri = format!("/generate?{text}").parse().unwrap();
        RequestOptions::from_query(&uri).map_err(|error| error.to_string())
    }

    #[test]
    fn every_option_is_read() {
        let options = query(
            "format=bvh&fps=24&seed=9007199254740991&temperature=0.5&top_k=7&guidance=2.5&candidates=3&redo=false\
             &start_upper=1&start_lower=2&continue_from=AQEjRWcAAEA_AAAAAAAAAAABAAIA&window=sliding&hop=15&offset_s=1.5&duration_s=2e1&root_motion=false\
             &music=true&include=rotations&encoding=base64&bvh_unit=m",
        )
        .unwrap();
        assert_eq!(options.given.len(), OPTIONS.len());
        assert_eq!(options.format, Some(OutputFormat::Bvh));
        assert_eq!(options.encoding, Some(Encoding::Base64));
        assert_eq!(options.bvh_unit, Some(BvhUnit::Metre));
        assert!(options.rotations);
        assert_eq!(
            options.generation(OutputFormat::Bvh),
            GenerationOptions {
                seed: Some(MAX_SEED),
                temperature: Some(0.5),
                top_k: Some(7),
                guidance: Some(2.5),
                candidates: Some(3),
                redo: Some(false),
                start_upper: Some(1),
                start_lower: Some(2),
                continue_from: Some(Continuation::new(
                    "01234567",
                    Codes {
                        upper: vec![1],
                        lower: vec![2],
                    },
                    [0.0; 2],
                    0.75,
                )),
                window: Some(WindowKind::Sliding),
                hop: Some(15),
                range: AudioRange {
                    offset_s: 1.5,
                    duration_s: Some(20.0),
                },
                fps: 24,
                root_motion: false,
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
    }

    #[test]
    fn what_does_not_fit_is_named_with_what_does() {
        let says = |text: &str, wanted: &str| {
            let problem = query(text).unwrap_err();
            assert!(problem.contains(wanted), "{text}: {problem}");
        };
        says(
            "fps=25",
            "option `fps`: got \"25\", expected one of 20, 24, 30, 60",
        );
        says(
            "seed=-1",
            "expected a whole number from 0 to 9007199254740991",
        );
        says("seed=9007199254740992", "option `seed`");
        says("seed=", "option `seed`: got \"\"");
        says("temperature=warm", "expected a number from 0 to 10");
        says("offset_s=-1", "expected a number, 0 or more");
        says("temperature=NaN", "option `temperature`");
        says("temperature=1e300", "option `temperature`");
        says("temperature=-0.1", "option `temperature`");
        says("guidance=11", "option `guidance`");
        says(
            "candidates=17",
            "option `candidates`: got \"17\", expected a whole number from 1 to 16",
        );
        says("top_k=0", "expected a whole number from 1 to");
        says("start_upper=4294967296", "option `start_upper`");
        says("duration_s=0", "expected a number above 0");
        says("duration_s=inf", "option `duration_s`");
        says("root_motion=maybe", "expected true or false");
        says("include=everything", "expected rotations");
        says(
            "seed=1&seed=1",
            "option `seed`: it was given more than once",
        );
        says(
            "sede=1",
            "there is no such option; there are format, fps, seed",
        );
        says(
            "continue_from=x",
            "expected the `tail` that came with an earlier dance",
        );
        says("format=glb", "glb is not available yet in this version");
        says("format=mp4", "expected one of json, bvh");
        says(&format!("seed={}", "1".repeat(10_000)), "1..");
    }
}
