//! The table of all options.

use std::str::FromStr;

use super::{RequestOptions, accepts::Accepts};
use crate::{
    engine::{MAX_CANDIDATES, MAX_GUIDANCE, MAX_SEED, MAX_TEMPERATURE},
    model::WindowKind,
    motion::FRAME_RATES,
};

/// One option: its name, what it does, what it accepts, and where it goes.
pub(super) struct OptionSpec {
    pub(super) name: &'static str,
    pub(super) about: &'static str,
    pub(super) accepts: Accepts,
    /// Takes a text that `accepts` admits; false if it does not fit the field after all.
    pub(super) read: fn(&mut RequestOptions, &str) -> bool,
}

pub(super) const OPTIONS: [OptionSpec; 20] = [
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
        name: "guidance",
        about: "How strongly the dance follows the music's beat: 1 as the model says, above it more so, below it less; other than 1 costs twice as much. Default: the model's.",
        accepts: Accepts::Number {
            most: MAX_GUIDANCE as f64,
        },
        read: |options, text| put(&mut options.guidance, text),
    },
    OptionSpec {
        name: "candidates",
        about: "Candidates for every two to four seconds of dance, of which that is taken whose beats lie nearest to the music's, less its share of frames that stand still; the cost grows with them. Default: the model's.",
        accepts: Accepts::Integer {
            least: 1,
            most: MAX_CANDIDATES as u64,
        },
        read: |options, text| put(&mut options.candidates, text),
    },
    OptionSpec {
        name: "redo",
        about: "Whether two to four seconds of dance in which the dancer stands still (of several candidates also: goes to the ground) are danced anew, up to three times and with at most 12 candidates in all. Default: the model's, and true with several candidates.",
        accepts: Accepts::Boolean,
        read: |options, text| put(&mut options.redo, text),
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
        name: "continue_from",
        about: "The `tail` of an earlier dance of the same model: the new one goes on from its last pose, place and facing, so that clips chain. Excludes start_upper and start_lower.",
        accepts: Accepts::Continuation,
        read: |options, text| put(&mut options.continue_from, text),
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
