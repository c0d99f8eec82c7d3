//! The one list of all options: the query, the form, the command line, `GET /info` and the OpenAPI
//! document are all made of it.

use super::accepts::{Accepts, boolean};
use crate::{
    engine::{GenerationOptions, MAX_CANDIDATES, MAX_GUIDANCE, MAX_SEED, MAX_TEMPERATURE},
    formats::{
        BvhUnit, Codes, Continuation, Encoding, OutputFormat, PositionsSource, TargetSkeleton,
    },
    model::WindowKind,
    motion::FRAME_RATES,
};

/// What an option is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Section {
    /// How pose codes are drawn.
    Sampling,
    /// Which part of the song, and what is made of the codes.
    Song,
    /// How the result is written; can still be chosen when it is fetched.
    Output,
    /// As [`Section::Output`], with a flag of another form on the command line.
    HttpOutput,
    /// As [`Section::Song`], with a flag of another form on the command line.
    HttpInput,
}

/// One option: its name, what it does, what it accepts, and where it goes.
#[derive(Clone, Copy)]
pub(crate) struct OptionSpec {
    pub(crate) name: &'static str,
    pub(crate) section: Section,
    pub(crate) accepts: Accepts,
    pub(crate) default: &'static str,
    pub(crate) about: &'static str,
    /// Takes a text that `accepts` admits; false if it does not fit the field after all.
    pub(super) read: fn(&mut RequestOptions, &str) -> bool,
}

/// A value that is read from the text of an option.
trait FromText: Sized {
    fn from_text(text: &str) -> Option<Self>;
}

macro_rules! from_text {
    ($($type:ty)+) => {
        $(impl FromText for $type {
            fn from_text(text: &str) -> Option<Self> {
                text.parse().ok()
            }
        })+
    };
}

from_text! {
    f32 f64 u32 u64 usize String BvhUnit Encoding OutputFormat TargetSkeleton Continuation Codes
}

impl FromText for bool {
    fn from_text(text: &str) -> Option<Self> {
        boolean(text)
    }
}

impl FromText for WindowKind {
    fn from_text(text: &str) -> Option<Self> {
        match text {
            "hop" => Some(Self::Hop),
            "sliding" => Some(Self::Sliding),
            _ => None,
        }
    }
}

/// What the JSON carries beside positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Include {
    Rotations,
}

impl FromText for Include {
    fn from_text(text: &str) -> Option<Self> {
        (text == "rotations").then_some(Self::Rotations)
    }
}

/// The value of `positions`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PositionsOption(pub(crate) PositionsSource);

impl FromText for PositionsOption {
    fn from_text(text: &str) -> Option<Self> {
        match text {
            "fk" => Some(Self(PositionsSource::ForwardKinematics)),
            "decoder" => Some(Self(PositionsSource::Decoder)),
            _ => None,
        }
    }
}

macro_rules! options {
    (
        Sampling { $($sampling:ident: $sampling_type:ty, $($sampling_spec:expr),+;)+ }
        $($section:ident { $($name:ident: $type:ty, $($spec:expr),+;)+ })+
    ) => {
        /// What a request asks for. `None` takes the default, which is the model's own where it has
        /// one.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct RequestOptions {
            $(pub(crate) $sampling: Option<$sampling_type>,)+
            $($(pub(crate) $name: Option<$type>,)+)+
            /// Names and texts of the options that were given.
            pub(super) given: Vec<(&'static str, String)>,
        }

        /// All options, in the order in which they are shown.
        pub(crate) const OPTIONS: &[OptionSpec] = &[
            $(options!(spec Sampling $sampling $($sampling_spec),+),)+
            $($(options!(spec $section $name $($spec),+),)+)+
        ];

        impl RequestOptions {
            /// The options that the engine takes as they are; the others have their defaults.
            pub(super) fn sampling(&self) -> GenerationOptions {
                GenerationOptions {
                    $($sampling: self.$sampling.clone(),)+
                    ..GenerationOptions::default()
                }
            }
        }
    };
    (spec $section:ident $name:ident $accepts:expr, $default:expr, $about:expr) => {
        OptionSpec {
            name: plain(stringify!($name)),
            section: Section::$section,
            accepts: $accepts,
            default: $default,
            about: $about,
            read: |options, text| {
                options.$name = FromText::from_text(text);
                options.$name.is_some()
            },
        }
    };
}

/// A field's name without the mark of a word that the language keeps for itself.
const fn plain(name: &'static str) -> &'static str {
    match name.as_bytes() {
        [b'r', b'#', ..] => name.split_at(2).1,
        _ => name,
    }
}

/// Names of all formats.
const FORMATS: [&str; OutputFormat::ALL.len()] = {
    let mut names = [""; OutputFormat::ALL.len()];
    let mut index = 0;
    while index < names.len() {
        names[index] = OutputFormat::ALL[index].name();
        index += 1;
    }
    names
};

const MODEL: &str = "the model's";
const ANY_CODE: Accepts = Accepts::Integer(0, u32::MAX as u64);
const ANY_COUNT: Accepts = Accepts::Integer(1, u32::MAX as u64);

options! {
    Sampling {
        seed: u64, Accepts::Integer(0, MAX_SEED), "drawn",
            "Seed of everything that is drawn; always returned. The same seed and song give the \
             same motion.";
        temperature: f32, Accepts::Number(MAX_TEMPERATURE as f64), MODEL,
            "0 takes the most likely pose code, as in the paper; higher values vary more.";
        top_k: usize, ANY_COUNT, MODEL, "Draw from this many most likely pose codes only.";
        style: String, Accepts::Style, "auto",
            "Style of the dance: one of the model's (`GET /info` lists them), `auto` for that of \
             the music, or `mixed` for none of them.";
        energy: f32, Accepts::Number(1.0), MODEL,
            "Energy of the dance, from 0 for the calmest of its style to 1 for the wildest; not \
             every model knows it.";
        guidance: f32, Accepts::Number(MAX_GUIDANCE as f64), MODEL,
            "How strongly the motion follows the music's beat, and the style: 1 as the model \
             says, more exaggerates both, less weakens them; any value but 1 doubles the cost.";
        candidates: usize, Accepts::Integer(1, MAX_CANDIDATES as u64), MODEL,
            "Candidates for every two to four seconds of motion. The one with the beats nearest to \
             the music's and the fewest frozen frames is kept; the cost grows with their number. \
             With `bars`, so many whole dances, in all of which the bars are looked for.";
        redo: bool, Accepts::Boolean, "the model's; true with several candidates",
            "Regenerate two to four seconds of motion in which the dancer freezes (with several \
             candidates also: goes to the ground), up to three times and with at most 12 \
             candidates in all.";
        form: bool, Accepts::Boolean, "false",
            "Whether the dance has the song's form: where a section of the song returns after \
             another, its choreography returns.";
        start_upper: u32, ANY_CODE, "drawn", "First pose code of the upper body.";
        start_lower: u32, ANY_CODE, "drawn", "First pose code of the lower body.";
        continue_from: Continuation, Accepts::Tail, "none",
            "The `tail` of an earlier result of the same model: the new motion continues from its \
             last pose, place and heading, so that clips chain. Excludes the first pose codes.";
        window: WindowKind, Accepts::Words(&["hop", "sliding"]), MODEL,
            "How the window of past pose codes moves: `hop` is fast, `sliding` is how the paper \
             samples.";
        hop: usize, ANY_COUNT, MODEL, "Pose codes kept when a hop window shrinks.";
    }
    Song {
        offset_s: f64, Accepts::Number(1e6), "0",
            "Where in the song the motion starts, in seconds.";
        duration_s: f64, Accepts::PositiveNumber, "to its end",
            "How many seconds of the song to use.";
        fps: u32, Accepts::IntegerOf(&FRAME_RATES), "60", "Frames per second.";
        root_motion: bool, Accepts::Boolean, "true",
            "Whether the dancer travels; false holds x and z of the root at 0 and keeps y.";
        mirror: bool, Accepts::Boolean, "false", "Whether left and right are exchanged.";
        clean: bool, Accepts::Boolean, "true, false with positions=decoder",
            "Whether to clean the motion: feet are held in place and above the floor, joints kept \
             within their limits, hands outside of the body, and jitter is removed.";
        positions: PositionsOption, Accepts::Words(&["fk", "decoder"]), "fk",
            "Where positions come from: `fk`, forward kinematics of the rotations that all formats \
             carry, or `decoder`, the decoder's own, at 60 frames a second and without clean-up.";
        bars: usize, Accepts::Integer(1, 64), "none, 4 with loop=true",
            "A clip of exactly this many bars of the part of the song: of all places in a few \
             dances, four at most unless `candidates` says how many, the bars whose end is most \
             like their start.";
        r#loop: bool, Accepts::Boolean, "false, true with bars",
            "Whether the end of such a clip flows into its start, in pose, speed, heading and \
             place.";
        music: bool, Accepts::Boolean, "true for json, else false",
            "Whether to find the music's tempo, beats and bars.";
    }
    Output {
        encoding: Encoding, Accepts::Words(&["json", "base64"]), "json",
            "How the JSON carries large arrays: `json` numbers, or `base64` of little-endian \
             float32.";
        bvh_unit: BvhUnit, Accepts::Words(&["cm", "m"]), "cm", "Unit of lengths in BVH.";
        skeleton: TargetSkeleton, Accepts::Words(&["smpl", "mixamo", "vrm", "unreal"]), "smpl",
            "Joint names, hierarchy, rest pose and bone axes of bvh, glb and fbx: the model's own \
             (`smpl`), or a T-pose of Mixamo, VRM or the Unreal mannequin.";
        mannequin: bool, Accepts::Boolean, "true",
            "Whether glb carries a doll that dances; without it there are bones alone.";
    }
    HttpInput {
        codes: Codes, Accepts::Codes, "chosen by the model",
            "Pose codes of the dance, which then are decoded as they are; a song is not needed. As \
             JSON: the `codes` of an earlier result, changed or not, or pairs [[upper, lower], \
             ..]. They decide the length, unless duration_s is shorter.";
    }
    HttpOutput {
        format: OutputFormat, Accepts::Words(&FORMATS), "json",
            "Format of the result. Wins over the Accept header.";
        include: Include, Accepts::Words(&["rotations"]), "nothing",
            "What else the JSON carries: `rotations` adds local rotations and the root's path.";
    }
}
