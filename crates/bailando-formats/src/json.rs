//! The JSON result (API.md).

use bailando_motion::{PositionsSource, Skeleton};
use serde::Serialize;

#[cfg(feature = "openapi")]
use crate::numbers::{PoseNumbers, RootNumbers};
use crate::{
    codes::Codes,
    continuation::Continuation,
    error::FormatError,
    motion::{GeneratedMotion, MotionSize, MusicInfo, Timings},
    numbers::{Block, Encoding, Numbers},
};

/// Contents of a JSON result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JsonOptions {
    /// Whether `rotations` and `root` are there (`include=rotations`).
    pub rotations: bool,
    /// Encoding of large arrays.
    pub encoding: Encoding,
}

/// A generated motion as JSON.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = Dance))]
pub struct MotionJson<'a> {
    /// Name of the model.
    model: &'a str,
    /// The seed that was used: with the same audio and options it gives the same motion.
    seed: u64,
    /// Frames per second.
    fps: u32,
    /// Number of frames.
    frames: usize,
    /// `frames / fps`.
    duration_s: f64,
    /// Seconds from the start of the song to the first frame: `offset_s`, and with `bars` or `loop`
    /// the place of the bars that were chosen.
    song_start_s: f64,
    skeleton: SkeletonJson<'a>,
    codes: &'a Codes,
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
    /// The value of `continue_from` for a motion that continues from the end of this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(nullable = false))]
    tail: Option<String>,
    /// Encoding of `positions`, `rotations` and `root`.
    encoding: Encoding,
    /// World positions in metres, `[frames][joints][x y z]`.
    #[cfg_attr(feature = "openapi", schema(value_type = PoseNumbers))]
    positions: Numbers<'a>,
    /// Local unit quaternions, `[frames][joints][x y z w]`; only with `include=rotations`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<PoseNumbers>, nullable = false))]
    rotations: Option<Numbers<'a>>,
    /// World position of the root joint in metres, `[frames][x y z]`; only with
    /// `include=rotations`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<RootNumbers>, nullable = false))]
    root: Option<Numbers<'a>>,
}

/// The rest skeleton.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = Skeleton))]
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

/// About the bytes of a motion as JSON.
pub(crate) fn json_bytes(size: MotionSize, options: &JsonOptions) -> usize {
    let frames = size.frames;
    // Positions; with rotations four more for each three of them, and three for the root.
    let poses = 3 * size.joints * frames;
    let numbers = poses + if options.rotations { poses * 4 / 3 + 3 * frames } else { 0 };
    // Codes, beats and names; a rounded number and its comma take about ten bytes.
    4096 + 2 * frames + 10 * numbers
}

/// Writes a motion as JSON.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity.
pub fn to_json(motion: &GeneratedMotion, options: &JsonOptions) -> Result<Vec<u8>, FormatError> {
    motion.check()?;
    let mut json = Vec::with_capacity(json_bytes(motion.size(), options));
    serde_json::to_writer(&mut json, &MotionJson::new(motion, options))?;
    Ok(json)
}

impl<'a> MotionJson<'a> {
    fn new(motion: &'a GeneratedMotion, options: &JsonOptions) -> Self {
        let animation = &motion.animation;
        let frames = animation.root.len();
        let encoding = options.encoding;
        let numbers = |block| Numbers { block, encoding };
        let wanted = |block| options.rotations.then(|| numbers(block));
        Self {
            model: &motion.model,
            seed: motion.seed,
            fps: animation.fps,
            frames,
            duration_s: frames as f64 / f64::from(animation.fps),
            song_start_s: motion.song_start_s,
            skeleton: (&motion.skeleton).into(),
            codes: &motion.codes,
            style: motion.style.as_deref(),
            music: motion.music.as_ref(),
            timings_ms: motion.timings,
            warnings: &motion.warnings,
            positions_source: motion.positions_source,
            tail: motion.continuation.as_ref().map(Continuation::to_text),
            encoding,
            positions: numbers(Block::Positions(motion.positions.view())),
            rotations: wanted(Block::Rotations(&animation.rotations)),
            root: wanted(Block::Root(&animation.root)),
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
