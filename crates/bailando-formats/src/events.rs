//! The events of a motion that is sent while it is generated (API.md, `POST /generate/stream`).

use bailando_motion::{Finished, PositionsSource, Skeleton};
use serde::Serialize;

#[cfg(feature = "openapi")]
use crate::numbers::{PoseNumbers, RootNumbers};
use crate::{
    codes::Codes,
    continuation::Continuation,
    error::FormatError,
    json::{JsonOptions, SkeletonJson},
    motion::{MusicInfo, Timings},
    numbers::{Block, Encoding, Numbers},
};

/// What is known before the first frame.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// Name of the model.
    pub model: &'a str,
    /// The seed that is used.
    pub seed: u64,
    /// Frames per second.
    pub fps: u32,
    /// Frames of the whole motion.
    pub frames: usize,
    /// Rest skeleton.
    pub skeleton: &'a Skeleton,
    /// Style of the dance, or `mixed`; none from a model without styles.
    pub style: Option<&'a str>,
    /// Tempo and beats, when asked for.
    pub music: Option<&'a MusicInfo>,
    /// Wall time of the stages so far.
    pub timings: Timings,
    /// What was trimmed, truncated or assumed.
    pub warnings: &'a [String],
    /// Where positions come from.
    pub positions_source: PositionsSource,
}

/// First event of a stream: what is known before the first frame.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = StartEvent))]
pub struct StartJson<'a> {
    /// `start`.
    event: &'static str,
    /// Name of the model.
    model: &'a str,
    /// The seed that is used.
    seed: u64,
    /// Frames per second.
    fps: u32,
    /// Frames of the whole motion.
    frames: usize,
    /// `frames / fps`.
    duration_s: f64,
    skeleton: SkeletonJson<'a>,
    /// Style of the dance, or `mixed`; absent from a model without styles.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(nullable = false))]
    style: Option<&'a str>,
    /// Absent unless asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(nullable = false))]
    music: Option<&'a MusicInfo>,
    timings_ms: Timings,
    /// What was trimmed, truncated or assumed, in plain words.
    warnings: &'a [String],
    positions_source: PositionsSource,
    /// Encoding of `positions`, `rotations` and `root`.
    encoding: Encoding,
}

/// Some frames of a motion, in their order.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = FramesEvent))]
pub struct FramesJson<'a> {
    /// `frames`.
    event: &'static str,
    /// Number of the first of these frames.
    first: usize,
    /// How many these are.
    count: usize,
    /// World positions in metres, `[count][joints][x y z]`.
    #[cfg_attr(feature = "openapi", schema(value_type = PoseNumbers))]
    positions: Numbers<'a>,
    /// Local unit quaternions, `[count][joints][x y z w]`; only with `include=rotations`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<PoseNumbers>, nullable = false))]
    rotations: Option<Numbers<'a>>,
    /// World position of the root joint in metres, `[count][x y z]`; only with `include=rotations`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<RootNumbers>, nullable = false))]
    root: Option<Numbers<'a>>,
}

/// Last event of a stream that went well.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = DoneEvent))]
pub struct DoneJson<'a> {
    /// `done`.
    event: &'static str,
    /// Frames that were sent.
    frames: usize,
    codes: &'a Codes,
    /// The value of `continue_from` for a motion that continues from the end of this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(nullable = false))]
    tail: Option<String>,
    timings_ms: Timings,
}

/// Writes the first event of a stream.
///
/// # Errors
/// None that is known; writing JSON is fallible by its type.
pub fn start_event(start: &Start<'_>, options: &JsonOptions) -> Result<Vec<u8>, FormatError> {
    Ok(serde_json::to_vec(&StartJson {
        event: "start",
        model: start.model,
        seed: start.seed,
        fps: start.fps,
        frames: start.frames,
        duration_s: start.frames as f64 / f64::from(start.fps.max(1)),
        skeleton: start.skeleton.into(),
        style: start.style,
        music: start.music,
        timings_ms: start.timings,
        warnings: start.warnings,
        positions_source: start.positions_source,
        encoding: options.encoding,
    })?)
}

/// Writes the frames of `part`, whose first is number `first`.
///
/// # Errors
/// [`FormatError::Inconsistent`] for a value that is no finite number.
pub fn frames_event(
    part: &Finished,
    first: usize,
    options: &JsonOptions,
) -> Result<Vec<u8>, FormatError> {
    if part.positions.iter().any(|value| !value.is_finite()) {
        return Err(FormatError::Inconsistent("a value is not finite".into()));
    }
    let encoding = options.encoding;
    let numbers = |block| Numbers { block, encoding };
    let wanted = |block| options.rotations.then(|| numbers(block));
    let animation = &part.animation;
    Ok(serde_json::to_vec(&FramesJson {
        event: "frames",
        first,
        count: animation.root.len(),
        positions: numbers(Block::Positions(part.positions.view())),
        rotations: wanted(Block::Rotations(&animation.rotations)),
        root: wanted(Block::Root(&animation.root)),
    })?)
}

/// Writes the last event of a stream.
///
/// # Errors
/// As [`start_event`].
pub fn done_event(
    frames: usize,
    codes: &Codes,
    continuation: Option<&Continuation>,
    timings: Timings,
) -> Result<Vec<u8>, FormatError> {
    Ok(serde_json::to_vec(&DoneJson {
        event: "done",
        frames,
        codes,
        tail: continuation.map(Continuation::to_text),
        timings_ms: timings,
    })?)
}
