//! The arguments of `bailando render`.

use std::path::PathBuf;

use clap::ValueEnum;

use crate::cli::console::positive_seconds;

/// Draw a dance as a film or a picture, with the viewer's own scene
///
/// Needs Chromium, and ffmpeg for films. The dance is JSON with rotations:
/// `bailando generate SONG -o dance.json --include-rotations`.
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(in crate::cli) struct RenderArgs {
    /// The dance, JSON with rotations
    pub(super) dance: PathBuf,
    /// The film or picture to write
    #[arg(short, long, value_name = "OUT.{mp4,gif,png}")]
    pub(super) output: PathBuf,
    /// The song, for the sound of an mp4
    #[arg(long, value_name = "SONG")]
    pub(super) audio: Option<PathBuf>,
    /// Where in the song the dance begins, in seconds [default: where it was made to: the dance's
    /// `song_start_s`]
    #[arg(long, value_parser = seconds)]
    pub(super) audio_offset_s: Option<f64>,
    /// Where in the dance the film begins, or which moment the picture shows
    #[arg(long, default_value_t = 0.0, value_parser = seconds)]
    pub(super) start_s: f64,
    /// Seconds of the dance [default: to its end]
    #[arg(long, value_parser = positive_seconds)]
    pub(super) duration_s: Option<f64>,
    /// Pictures a second [default: 30, 15 for gif]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=60))]
    pub(super) fps: Option<u32>,
    /// Width and height in pixels
    #[arg(long, default_value = "960x720", value_name = "WxH", value_parser = size)]
    pub(super) size: Size,
    /// Where the camera stands
    #[arg(long, value_enum, default_value_t)]
    pub(super) look: Look,
    /// Keep the camera where it is instead of following the dancer; makes a gif a lot smaller
    #[arg(long)]
    pub(super) fixed: bool,
    /// The figure
    #[arg(long, value_enum, default_value_t)]
    pub(super) figure: Figure,
    /// Dark instead of light
    #[arg(long)]
    pub(super) dark: bool,
    /// The browser
    #[arg(long, env = "CHROMIUM", hide_env_values = true, value_name = "PROGRAM")]
    pub(super) chromium: Option<PathBuf>,
    /// The encoder of films
    #[arg(
        long,
        env = "FFMPEG",
        hide_env_values = true,
        default_value = "ffmpeg",
        value_name = "PROGRAM"
    )]
    pub(super) ffmpeg: PathBuf,
}

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Size {
    pub(super) width: u32,
    pub(super) height: u32,
}

/// Where the camera stands.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(super) enum Look {
    /// In front, a little to the side
    #[default]
    Portrait,
    Front,
    Side,
    Top,
}

/// The figure that dances.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(super) enum Figure {
    #[default]
    Slender,
    Broad,
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok();
    seconds.filter(|seconds| (0.0..1e6).contains(seconds)).ok_or("expected seconds from 0".into())
}

/// Reads a size. H.264 has even sizes only, and what is larger than 4K takes minutes a picture.
fn size(text: &str) -> Result<Size, String> {
    let sides = text.split_once('x').and_then(|(width, height)| {
        Some((width.parse::<u32>().ok()?, height.parse::<u32>().ok()?))
    });
    let fits = |side: u32| (64..=3840).contains(&side) && side.is_multiple_of(2);
    match sides {
        Some((width, height)) if fits(width) && fits(height) => Ok(Size { width, height }),
        _ => Err("expected even numbers from 64 to 3840, as 960x720".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_even_and_bounded() {
        assert_eq!(size("960x720"), Ok(Size { width: 960, height: 720 }));
        for wrong in ["", "960", "961x720", "0x0", "62x64", "9600x720", "-2x64", "x"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }
}
