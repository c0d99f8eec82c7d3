//! What a caller may choose about a generation.

use crate::{audio::AudioRange, model::WindowKind};

/// What a caller may choose about a generation (API.md). `None` means the manifest's default.
#[derive(Clone, Debug, PartialEq)]
pub struct GenerationOptions {
    /// Seed of the one generator of this request; drawn if absent.
    pub seed: Option<u64>,
    /// 0 takes the most likely code.
    pub temperature: Option<f32>,
    /// Draw from this many most likely codes.
    pub top_k: Option<usize>,
    /// First upper pose code; drawn from the manifest's list if absent.
    pub start_upper: Option<u32>,
    /// First lower pose code; drawn from the manifest's list if absent.
    pub start_lower: Option<u32>,
    /// How the window of past codes moves.
    pub window: Option<WindowKind>,
    /// Codes kept when a hop window shrinks.
    pub hop: Option<usize>,
    /// Which part of the song.
    pub range: AudioRange,
    /// Frames per second of the result: 20, 24, 30 or 60.
    pub fps: u32,
    /// Whether the dancer travels; `false` holds x and z of the root at 0 and keeps y.
    pub root_motion: bool,
    /// Whether to find the music's tempo and beats.
    pub music: bool,
}

impl Default for GenerationOptions {
    fn default() -> Self {
        Self {
            seed: None,
            temperature: None,
            top_k: None,
            start_upper: None,
            start_lower: None,
            window: None,
            hop: None,
            range: AudioRange::default(),
            fps: 60,
            root_motion: true,
            music: false,
        }
    }
}
