//! Pictures to a file: ffmpeg for films, the picture itself for PNG.

use std::{
    fs,
    io::{Read, Write},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, Stdio},
};

use anyhow::Context;

use super::arguments::RenderArgs;
use crate::cli::console::{Usage, write_file};

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Mp4,
    Gif,
    Png,
}

impl Kind {
    pub(super) fn of(path: &Path) -> Result<Self, Usage> {
        let extension = path.extension().and_then(|extension| extension.to_str());
        match extension.map(str::to_ascii_lowercase).as_deref() {
            Some("mp4") => Ok(Self::Mp4),
            Some("gif") => Ok(Self::Gif),
            Some("png") => Ok(Self::Png),
            _ => {
                let path = path.display();
                Err(Usage(format!("{path}: the extension chooses the kind: mp4, gif or png")))
            }
        }
    }

    /// Pictures a second by default.
    pub(super) fn fps(self) -> u32 {
        match self {
            Self::Gif => 15,
            Self::Mp4 | Self::Png => 30,
        }
    }
}

/// Takes pictures, one after another.
pub(super) enum Encoder {
    Ffmpeg { child: Child, pictures: Option<ChildStdin> },
    Picture { path: PathBuf },
}

impl Encoder {
    /// Starts ffmpeg where it is needed, with the song from `sound_s` on.
    pub(super) fn start(
        args: &RenderArgs,
        kind: Kind,
        (fps, frames): (u32, u32),
        sound_s: f64,
    ) -> anyhow::Result<Self> {
        if kind == Kind::Png {
            return Ok(Self::Picture { path: args.output.clone() });
        }
        let mut command = Command::new(&args.ffmpeg);
        command.args(["-hide_banner", "-loglevel", "error", "-y"]);
        command.args(["-f", "image2pipe", "-c:v", "png", "-framerate", &fps.to_string()]);
        command.args(["-i", "-"]);
        match kind {
            Kind::Mp4 => {
                let sound = args.audio.as_deref().map(|song| (song, sound_s));
                film(&mut command, sound, f64::from(frames) / f64::from(fps))?
            }
            // Few colours, and only what has changed: a small file.
            Kind::Gif | Kind::Png => command.args([
                "-filter_complex",
                "split[a][b];[a]palettegen=max_colors=64:stats_mode=diff[p];\
                 [b][p]paletteuse=dither=none:diff_mode=rectangle",
                "-loop",
                "0",
            ]),
        };
        // A file named `-o` or with a colon is a file.
        command.arg(format!("file:{}", args.output.display()));
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let program = args.ffmpeg.display();
        let mut child = command.spawn().map_err(|error| {
            Usage(format!(
                "{program}: {error}; films need ffmpeg: install it (Debian: apt-get install \
                 ffmpeg), name it with --ffmpeg, or write a png"
            ))
        })?;
        let pictures = child.stdin.take();
        Ok(Self::Ffmpeg { child, pictures })
    }

    pub(super) fn write(&mut self, picture: &[u8]) -> anyhow::Result<()> {
        match self {
            Self::Ffmpeg { pictures, .. } => {
                let pictures = pictures.as_mut().context("ffmpeg takes no pictures")?;
                pictures.write_all(picture).context("ffmpeg takes no more pictures")
            }
            Self::Picture { path } => write_file(path, picture),
        }
    }

    /// Waits until the file is complete.
    pub(super) fn end(self) -> anyhow::Result<()> {
        let Self::Ffmpeg { mut child, pictures } = self else {
            return Ok(());
        };
        drop(pictures);
        let mut said = String::new();
        if let Some(mut errors) = child.stderr.take() {
            errors.read_to_string(&mut said).context("ffmpeg")?;
        }
        let status = child.wait().context("ffmpeg")?;
        let reason = said.lines().last().unwrap_or("it said nothing");
        anyhow::ensure!(status.success(), "ffmpeg ended with {status}: {reason}");
        Ok(())
    }
}

/// A film of `seconds` that plays everywhere, with its sound: a song from a moment on.
fn film<'a>(
    command: &'a mut Command,
    sound: Option<(&Path, f64)>,
    seconds: f64,
) -> anyhow::Result<&'a mut Command> {
    if let Some((song, start)) = sound {
        fs::metadata(song).with_context(|| song.display().to_string())?;
        command.args(["-ss", &start.to_string(), "-t", &seconds.to_string(), "-i"]);
        command.arg(format!("file:{}", song.display()));
        command.args(["-map", "0:v", "-map", "1:a", "-c:a", "aac", "-b:a", "160k"]);
    }
    Ok(command.args(["-c:v", "libx264", "-preset", "medium", "-crf", "20"]).args([
        "-pix_fmt",
        "yuv420p",
        "-movflags",
        "+faststart",
    ]))
}
