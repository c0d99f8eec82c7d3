//! The options of a generation: one table that the parser, its error messages and the OpenAPI
//! document are all made of.

use std::{fmt, str::FromStr};

use utoipa::{
    IntoParams,
    openapi::{
        RefOr,
        path::{Parameter, ParameterBuilder, ParameterIn},
        schema::{KnownFormat, Object, ObjectBuilder, Schema, SchemaFormat, Type},
    },
};

use super::error::ServerError;
use crate::{
    audio::AudioRange,
    engine::{GenerationOptions, MAX_SEED, MAX_TEMPERATURE},
    format::{BvhUnit, Dance, Encoding, JsonOptions, OutputFormat},
    model::WindowKind,
    motion::FRAME_RATES,
};

/// Longest option value that is looked at, in bytes.
pub(crate) const LONGEST_VALUE: usize = 256;
/// Options of later versions.
const NOT_YET: [&str; 1] = ["continue_from"];
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
    start_upper: Option<u32>,
    start_lower: Option<u32>,
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

/// One option: its name, what it does, what it accepts, and where it goes.
struct OptionSpec {
    name: &'static str,
    about: &'static str,
    accepts: Accepts,
    /// Takes a text that `accepts` admits; false if it does not fit the field after all.
    read: fn(&mut RequestOptions, &str) -> bool,
}

/// What an option accepts.
#[derive(Clone, Copy)]
enum Accepts {
    Words(&'static [&'static str]),
    IntegerOf(&'static [u32]),
    /// From `least` to `most`.
    Integer {
        least: u64,
        most: u64,
    },
    /// From 0 to `most`.
    Number {
        most: f64,
    },
    /// Above 0.
    PositiveNumber,
    Boolean,
}

const OPTIONS: [OptionSpec; 16] = [
    OptionSpec {
        name: "format",
        about: "Format of the dance. Wins over the Accept header. Default: json.",
        accepts: Accepts::Words(&["json", "bvh"]),
        read: |options, text| put(&mut options.format, text),
    },
    OptionSpec {
        name: "fps",
        about: "Frames per second. Default: 60.",
        accepts: Accepts::IntegerOf(&FRAME_RATES),
        read: |options, text| put(&mut options.fps, text),
    },
    OptionSpec {
        name: "seed",
        about: "Seed of everything that is drawn. Drawn itself if absent, and always returned.",
        accepts: Accepts::Integer {
            least: 0,
            most: MAX_SEED,
        },
        read: |options, text| put(&mut options.seed, text),
    },
    OptionSpec {
        name: "temperature",
        about: "0 takes the most likely pose code, as in the paper; higher is livelier. Default: the model's.",
        accepts: Accepts::Number {
            most: MAX_TEMPERATURE as f64,
        },
        read: |options, text| put(&mut options.temperature, text),
    },
    OptionSpec {
        name: "top_k",
        about: "Draw from this many most likely pose codes. Default: the model's.",
        accepts: Accepts::Integer {
            least: 1,
            most: u32::MAX as u64,
        },
        read: |options, text| put(&mut options.top_k, text),
    },
    OptionSpec {
        name: "start_upper",
        about: "First pose code of the upper body. Drawn if absent.",
        accepts: Accepts::Integer {
            least: 0,
            most: u32::MAX as u64,
        },
        read: |options, text| put(&mut options.start_upper, text),
    },
    OptionSpec {
        name: "start_lower",
        about: "First pose code of the lower body. Drawn if absent.",
        accepts: Accepts::Integer {
            least: 0,
            most: u32::MAX as u64,
        },
        read: |options, text| put(&mut options.start_lower, text),
    },
    OptionSpec {
        name: "window",
        about: "How the window of past pose codes moves: `hop` is fast, `sliding` is how the paper samples. Default: the model's.",
        accepts: Accepts::Words(&["hop", "sliding"]),
        read: |options, text| {
            options.window = Some(match text {
                "hop" => WindowKind::Hop,
                _ => WindowKind::Sliding,
            });
            true
        },
    },
    OptionSpec {
        name: "hop",
        about: "Pose codes kept when a hop window shrinks. Default: the model's.",
        accepts: Accepts::Integer {
            least: 1,
            most: u32::MAX as u64,
        },
        read: |options, text| put(&mut options.hop, text),
    },
    OptionSpec {
        name: "offset_s",
        about: "Where in the song the dance starts, in seconds. Default: 0.",
        accepts: Accepts::Number { most: f64::MAX },
        read: |options, text| put(&mut options.offset_s, text),
    },
    OptionSpec {
        name: "duration_s",
        about: "How many seconds of the song to dance to. Default: to its end.",
        accepts: Accepts::PositiveNumber,
        read: |options, text| put(&mut options.duration_s, text),
    },
    OptionSpec {
        name: "root_motion",
        about: "Whether the dancer travels; false holds x and z of the root at 0 and keeps y. Default: true.",
        accepts: Accepts::Boolean,
        read: |options, text| put(&mut options.root_motion, text),
    },
    OptionSpec {
        name: "music",
        about: "Whether to find the music's tempo and beats. Default: true for json, false for bvh.",
        accepts: Accepts::Boolean,
        read: |options, text| put(&mut options.music, text),
    },
    OptionSpec {
        name: "include",
        about: "What else the JSON carries: `rotations` adds local rotations and the root's path.",
        accepts: Accepts::Words(&["rotations"]),
        read: |options, _| {
            options.rotations = true;
            true
        },
    },
    OptionSpec {
        name: "encoding",
        about: "How the JSON carries large arrays: `json` numbers, or `base64` of little-endian float32. Default: json.",
        accepts: Accepts::Words(&["json", "base64"]),
        read: |options, text| put(&mut options.encoding, text),
    },
    OptionSpec {
        name: "bvh_unit",
        about: "Unit of lengths in BVH. Default: cm.",
        accepts: Accepts::Words(&["cm", "m"]),
        read: |options, text| put(&mut options.bvh_unit, text),
    },
];

fn put<T: FromStr>(slot: &mut Option<T>, text: &str) -> bool {
    *slot = text.parse().ok();
    slot.is_some()
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
            return refuse(if NOT_YET.contains(&name) {
                "it is not available yet in this version".to_owned()
            } else {
                let names: Vec<&str> = OPTIONS.iter().map(|option| option.name).collect();
                format!("there is no such option; there are {}", names.join(", "))
            });
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

    /// Writes `dance` as asked for.
    pub(crate) fn write(&self, dance: &Dance, format: OutputFormat) -> crate::Result<Vec<u8>> {
        let json = JsonOptions {
            rotations: self.rotations,
            encoding: self.encoding.unwrap_or_default(),
        };
        let bytes = format.write(dance, &json, self.bvh_unit.unwrap_or_default())?;
        Ok(bytes)
    }

    /// The engine's part of the options.
    pub(crate) fn generation(&self, format: OutputFormat) -> GenerationOptions {
        let default = GenerationOptions::default();
        GenerationOptions {
            seed: self.seed,
            temperature: self.temperature,
            top_k: self.top_k,
            start_upper: self.start_upper,
            start_lower: self.start_lower,
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

impl Accepts {
    fn admits(self, text: &str) -> bool {
        let number = || text.parse::<f64>().ok().filter(|value| value.is_finite());
        match self {
            Self::Words(words) => words.contains(&text),
            Self::IntegerOf(values) => text.parse().is_ok_and(|value| values.contains(&value)),
            Self::Integer { least, most } => text
                .parse::<u64>()
                .is_ok_and(|value| (least..=most).contains(&value)),
            Self::Number { most } => number().is_some_and(|value| (0.0..=most).contains(&value)),
            Self::PositiveNumber => number().is_some_and(|value| value > 0.0),
            Self::Boolean => text.parse::<bool>().is_ok(),
        }
    }

    fn schema(self) -> Object {
        let of = |kind: Type| ObjectBuilder::new().schema_type(kind);
        match self {
            Self::Words(words) => of(Type::String).enum_values(Some(words.iter().copied())),
            Self::IntegerOf(values) => of(Type::Integer).enum_values(Some(values.iter().copied())),
            Self::Integer { least, most } => {
                of(Type::Integer).minimum(Some(least)).maximum(Some(most))
            }
            Self::Number { most } if most == f64::MAX => of(Type::Number).minimum(Some(0)),
            Self::Number { most } => of(Type::Number).minimum(Some(0)).maximum(Some(most)),
            Self::PositiveNumber => of(Type::Number).exclusive_minimum(Some(0)),
            Self::Boolean => of(Type::Boolean),
        }
        .build()
    }
}

impl fmt::Display for Accepts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Words(words) => match words {
                [word] => f.write_str(word),
                _ => write!(f, "one of {}", words.join(", ")),
            },
            Self::IntegerOf(values) => {
                let values: Vec<String> = values.iter().map(u32::to_string).collect();
                write!(f, "one of {}", values.join(", "))
            }
            Self::Integer { least, most } => write!(f, "a whole number from {least} to {most}"),
            Self::Number { most } if *most == f64::MAX => f.write_str("a number, 0 or more"),
            Self::Number { most } => write!(f, "a number from 0 to {most}"),
            Self::PositiveNumber => f.write_str("a number above 0"),
            Self::Boolean => f.write_str("true or false"),
        }
    }
}

impl IntoParams for RequestOptions {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        OPTIONS
            .iter()
            .map(|option| {
                ParameterBuilder::new()
                    .name(option.name)
                    .parameter_in(ParameterIn::Query)
                    .required(utoipa::openapi::Required::False)
                    .description(Some(option.about))
                    .schema(Some(option.accepts.schema()))
                    .build()
            })
            .collect()
    }
}

/// The bytes of an audio file, as the OpenAPI document shows them.
pub(crate) struct AudioFile;

impl utoipa::PartialSchema for AudioFile {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new()
            .schema_type(Type::String)
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)))
            .description(Some("The song: wav, flac, mp3, ogg/vorbis or m4a/aac."))
            .into()
    }
}

impl utoipa::ToSchema for AudioFile {}

/// The multipart form: the audio and any of the options, as the OpenAPI document shows it.
pub(crate) struct GenerateForm;

impl utoipa::PartialSchema for GenerateForm {
    fn schema() -> RefOr<Schema> {
        let form = ObjectBuilder::new()
            .property("file", AudioFile::schema())
            .required("file")
            .additional_properties(Some(
                utoipa::openapi::schema::AdditionalProperties::<Schema>::FreeForm(false),
            ));
        OPTIONS
            .iter()
            .fold(form, |form, option| {
                let mut schema = option.accepts.schema();
                schema.description = Some(option.about.to_owned());
                form.property(option.name, schema)
            })
            .into()
    }
}

impl utoipa::ToSchema for GenerateForm {}

#[cfg(test)]
mod tests {
    use super::*;

    fn query(text: &str) -> Result<RequestOptions, String> {
        let uri = format!("/generate?{text}").parse().unwrap();
        RequestOptions::from_query(&uri).map_err(|error| error.to_string())
    }

    #[test]
    fn every_option_is_read() {
        let options = query(
            "format=bvh&fps=24&seed=9007199254740991&temperature=0.5&top_k=7&start_upper=1\
             &start_lower=2&window=sliding&hop=15&offset_s=1.5&duration_s=2e1&root_motion=false\
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
                start_upper: Some(1),
                start_lower: Some(2),
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
        says("continue_from=x", "not available yet");
        says("format=glb", "glb is not available yet in this version");
        says("format=mp4", "expected one of json, bvh");
        says(&format!("seed={}", "1".repeat(10_000)), "1..");
    }
}
