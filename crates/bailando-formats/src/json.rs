//! The JSON result (API.md).

use std::{str::FromStr, time::Duration};

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    Codes, Dance, FormatError, MusicInfo, Tail, Timings,
    numbers::{Block, Numbers, PoseNumbers, RootNumbers},
};
use bailando_motion::{PositionsSource, Skeleton};

/// How large arrays of numbers are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// Nested JSON arrays, numbers rounded to 6 decimals (a micrometre: what remains is smooth
    /// enough for speeds and accelerations to be taken from it).
    #[default]
    Json,
    /// A base64 string of little-endian float32 in the same order, nothing rounded.
    Base64,
}

impl FromStr for Encoding {
    type Err = FormatError;

    fn from_str(name: &str) -> Result<Self, FormatError> {
        match name {
            "json" => Ok(Self::Json),
            "base64" => Ok(Self::Base64),
            _ => Err(FormatError::Choice {
                name: "encoding",
                got: name.into(),
                accepted: "json or base64",
            }),
        }
    }
}

/// What a JSON result holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JsonOptions {
    /// Whether `rotations` and `root` are there (`include=rotations`).
    pub rotations: bool,
    /// How large arrays are written.
    pub encoding: Encoding,
}

/// A dance as JSON.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Dance)]
pub struct DanceJson<'a> {
    /// Name of the model.
    model: &'a str,
    /// The seed that was used: with the same audio and options it gives the same dance.
    seed: u64,
    /// Frames per second.
    fps: u32,
    /// Number of frames.
    frames: usize,
    /// `frames / fps`.
    duration_s: f64,
    skeleton: SkeletonJson<'a>,
    codes: CodesJson<'a>,
    /// Absent unless asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    music: Option<MusicJson<'a>>,
    timings_ms: TimingsJson,
    /// What was trimmed, truncated or assumed, in plain words.
    warnings: &'a [String],
    positions_source: SourceJson,
    /// The option `continue_from` of a dance that is to go on from the end of this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    tail: Option<String>,
    /// How `positions`, `rotations` and `root` are written.
    encoding: Encoding,
    /// World positions in metres, `[frames][joints][x y z]`.
    #[schema(value_type = PoseNumbers)]
    positions: Numbers<'a>,
    /// Local unit quaternions, `[frames][joints][x y z w]`; only with `include=rotations`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<PoseNumbers>, nullable = false)]
    rotations: Option<Numbers<'a>>,
    /// World position of the root joint in metres, `[frames][x y z]`; only with
    /// `include=rotations`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<RootNumbers>, nullable = false)]
    root: Option<Numbers<'a>>,
}

/// The rest skeleton.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Skeleton)]
pub struct SkeletonJson<'a> {
    /// Names of the joints, in the order of `positions`.
    joints: &'a [String],
    /// Parent of each joint; -1 for the root.
    parents: &'a [i32],
    /// Offset of each joint from its parent in the rest pose, metres; the rest pose faces +z.
    offsets: &'a [[f32; 3]],
    /// Axis that points up: `y`.
    up: &'static str,
    /// Handedness of the axes: `right`. The dancer's left is at +x when facing +z.
    handedness: &'static str,
}

/// Pose codes, one pair for 8 frames at 60 fps.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Codes)]
pub struct CodesJson<'a> {
    /// Upper half of the body.
    upper: &'a [u32],
    /// Lower half of the body.
    lower: &'a [u32],
}

/// What was heard in the music.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Music)]
pub struct MusicJson<'a> {
    /// Beats per minute; 0 when none were found.
    tempo_bpm: f64,
    /// Beats in seconds from the start of the dance.
    beats_s: &'a [f64],
}

/// Milliseconds per stage.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[schema(as = Timings)]
pub struct TimingsJson {
    /// Waiting in line, then for the model.
    queue: f64,
    /// Decoding and resampling the audio.
    decode: f64,
    /// Music features.
    features: f64,
    /// Codes and decoded motion.
    inference: f64,
    /// Rotations, floor and frame rate.
    motion: f64,
}

/// Where positions come from.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = PositionsSource)]
pub enum SourceJson {
    /// The decoder's own positions.
    Decoder,
    /// Forward kinematics of resampled rotations.
    ForwardKinematics,
}

/// Writes a dance as JSON.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity.
pub fn to_json(dance: &Dance, options: &JsonOptions) -> Result<Vec<u8>, FormatError> {
    dance.check()?;
    let numbers = dance.positions.len() * if options.rotations { 3 } else { 1 };
    // A rounded number and its comma take about ten bytes.
    let mut json = Vec::with_capacity(4096 + 10 * numbers);
    serde_json::to_writer(&mut json, &DanceJson::new(dance, options))?;
    Ok(json)
}

impl<'a> DanceJson<'a> {
    fn new(dance: &'a Dance, options: &JsonOptions) -> Self {
        let frames = dance.animation.root.len();
        let numbers = |block| Numbers::new(block, options.encoding);
        let animation = &dance.animation;
        Self {
            model: &dance.model,
            seed: dance.seed,
            fps: animation.fps,
            frames,
            duration_s: frames as f64 / f64::from(animation.fps),
            skeleton: (&dance.skeleton).into(),
            codes: (&dance.codes).into(),
            music: dance.music.as_ref().map(MusicJson::from),
            timings_ms: dance.timings.into(),
            warnings: &dance.warnings,
            positions_source: dance.positions_source.into(),
            tail: dance.tail.as_ref().map(Tail::to_text),
            encoding: options.encoding,
            positions: numbers(Block::Positions(dance.positions.view())),
            rotations: options
                .rotations
                .then(|| numbers(Block::Rotations(&animation.rotations))),
            root: options
                .rotations
                .then(|| numbers(Block::Root(&animation.root))),
        }
    }
}

impl<'a> From<&'a Skeleton> for SkeletonJson<'a> {
    fn from(skeleton: &'a Skeleton) -> Self {
        Self {
            joints: &skeleton.joints,
            parents: &skeleton.parents,
            offsets: &skeleton.offsets,
            up: "y",
            handedness: "right",
        }
    }
}

impl<'a> From<&'a Codes> for CodesJson<'a> {
    fn from(codes: &'a Codes) -> Self {
        Self {
            upper: &codes.upper,
            lower: &codes.lower,
        }
    }
}

impl<'a> From<&'a MusicInfo> for MusicJson<'a> {
    fn from(music: &'a MusicInfo) -> Self {
        Self {
            tempo_bpm: music.tempo_bpm,
            beats_s: &music.beats_s,
        }
    }
}

impl From<Timings> for TimingsJson {
    fn from(timings: Timings) -> Self {
        let milliseconds = |time: Duration| time.as_micros() as f64 / 1000.0;
        Self {
            queue: milliseconds(timings.queue),
            decode: milliseconds(timings.decode),
            features: milliseconds(timings.features),
            inference: milliseconds(timings.inference),
            motion: milliseconds(timings.motion),
        }
    }
}

impl From<PositionsSource> for SourceJson {
    fn from(source: PositionsSource) -> Self {
        match source {
            PositionsSource::Decoder => Self::Decoder,
            PositionsSource::ForwardKinematics => Self::ForwardKinematics,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};
    use serde_json::Value;
    use utoipa::OpenApi;

    use super::*;
    use bailando_motion::Animation;

    #[derive(OpenApi)]
    #[openapi(components(schemas(DanceJson<'_>)))]
    struct Document;

    fn keys(object: &Value) -> Vec<&String> {
        let mut keys: Vec<&String> = object.as_object().unwrap().keys().collect();
        keys.sort();
        keys
    }

    #[test]
    fn the_schema_describes_what_is_written() {
        let document = serde_json::to_value(Document::openapi()).unwrap();
        let schemas = &document["components"]["schemas"];
        let dance = Dance {
            model: "still".into(),
            seed: 1,
            skeleton: Skeleton {
                joints: vec!["pelvis".into()],
                parents: vec![-1],
                offsets: vec![[0.0; 3]],
                root_height: 0.9,
            },
            animation: Animation {
                fps: 60,
                root: vec![Vec3::Y],
                rotations: vec![vec![Quat::IDENTITY]],
            },
            positions: ndarray::array![[[0.0, 1.0, 0.0]]],
            positions_source: PositionsSource::Decoder,
            codes: Codes::default(),
            music: Some(MusicInfo {
                tempo_bpm: 0.0,
                beats_s: Vec::new(),
            }),
            timings: Timings::default(),
            warnings: Vec::new(),
            tail: Some(Tail::new("00", Codes::default(), [0.0; 2], 0.0)),
        };
        let options = JsonOptions {
            rotations: true,
            encoding: Encoding::Base64,
        };
        let written: Value = serde_json::from_slice(&to_json(&dance, &options).unwrap()).unwrap();
        assert_eq!(keys(&written), keys(&schemas["Dance"]["properties"]));
        for (key, schema) in [
            ("skeleton", "Skeleton"),
            ("codes", "Codes"),
            ("music", "Music"),
            ("timings_ms", "Timings"),
        ] {
            assert_eq!(keys(&written[key]), keys(&schemas[schema]["properties"]));
        }
        assert_eq!(written["root"], "AAAAAAAAgD8AAAAA");
    }
}
