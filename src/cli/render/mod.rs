//! `bailando render`: a dance as a film or a picture, drawn by the viewer.

mod arguments;
mod browser;
mod encoder;

use std::{path::Path, time::Duration};

use anyhow::Context;
use bailando::server::{Film, serve_film};
use clap::ValueEnum;
use tokio::{net::TcpListener, runtime::Runtime, sync::mpsc, time::timeout};

pub(super) use self::arguments::RenderArgs;
use self::{
    arguments::Size,
    browser::Browser,
    encoder::{Encoder, Kind},
};
use super::{
    console::{Usage, note, read_file, say, with_causes},
    output::check_folder_of,
};

/// Pictures that wait for the encoder: the browser draws the next ones meanwhile.
const AHEAD: usize = 4;
/// How long the next picture may take; the first one comes with the whole page.
const PATIENCE: Duration = Duration::from_secs(120);

pub(super) fn run(args: &RenderArgs) -> anyhow::Result<()> {
    let kind = Kind::of(&args.output)?;
    check_folder_of(&args.output)?;
    if args.audio.is_some() && kind != Kind::Mp4 {
        return Err(Usage("only mp4 has sound: leave --audio out".into()).into());
    }
    let dance = Dance::read(&args.dance)?;
    let fps = args.fps.unwrap_or(kind.fps());
    let frames = args.frames(&dance, kind, fps)?;
    let browser = Browser::find(args.chromium.as_deref())?;
    let sound_s = args.audio_offset_s.unwrap_or(dance.song_start_s) + args.start_s;
    let mut encoder = Encoder::start(args, kind, (fps, frames), sound_s)?;
    let runtime = Runtime::new()?;
    let shot = runtime.block_on(shoot(args, dance, &browser, &mut encoder, (fps, frames)));
    match (shot, encoder.end()) {
        (Ok(()), ended) => ended?,
        // A film that broke off: the encoder's own words may be the reason.
        (Err(shot), Err(ended)) => {
            anyhow::bail!("{}; {}", with_causes(&shot), with_causes(&ended))
        }
        (Err(shot), Ok(())) => return Err(shot),
    }
    say(&format!("{}: {frames} pictures at {fps} a second", args.output.display()));
    Ok(())
}

/// Has all pictures drawn, and gives them to the encoder.
async fn shoot(
    args: &RenderArgs,
    dance: Dance,
    browser: &Browser,
    encoder: &mut Encoder,
    (fps, frames): (u32, u32),
) -> anyhow::Result<()> {
    let listener = TcpListener::bind(("127.0.0.1", 0)).await?;
    let token = uuid::Uuid::new_v4().simple().to_string();
    let Size { width, height } = args.size;
    let address = format!(
        "http://{}/?film={token}&width={width}&height={height}&start={}&fps={fps}&frames={frames}\
         &look={}&figure={}&camera={}&theme={}",
        listener.local_addr()?,
        args.start_s,
        name(args.look),
        name(args.figure),
        if args.fixed { "fixed" } else { "follows" },
        if args.dark { "dark" } else { "light" },
    );
    let (pictures, mut received) = mpsc::channel(AHEAD);
    let film = Film { dance: dance.json.into(), token, pictures };
    let server = tokio::spawn(serve_film(listener, film));
    let mut running = browser.open(&address, args.size)?;
    for number in 0..frames {
        let picture = tokio::select! {
            picture = timeout(PATIENCE, received.recv()) => picture,
            ended = running.ended() => anyhow::bail!("{}: {ended}", browser.program.display()),
        };
        let waited = || format!("no picture came within {} s", PATIENCE.as_secs());
        let picture = picture.with_context(waited)?.context("the server ended")?;
        let picture =
            picture.map_err(|reason| anyhow::anyhow!("the page cannot draw: {reason}"))?;
        encoder.write(&picture)?;
        if (number + 1).is_multiple_of(10 * fps) {
            note(&format!("{} of {frames} pictures", number + 1));
        }
    }
    server.abort();
    Ok(())
}

fn name(value: impl ValueEnum) -> String {
    value.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

/// A dance that can be drawn.
struct Dance {
    json: Vec<u8>,
    seconds: f64,
    /// Where in the song it begins.
    song_start_s: f64,
}

impl Dance {
    fn read(path: &Path) -> anyhow::Result<Self> {
        #[derive(serde::Deserialize)]
        struct Head {
            frames: u32,
            fps: u32,
            /// What an earlier release wrote has none.
            #[serde(default)]
            song_start_s: f64,
            rotations: Option<serde::de::IgnoredAny>,
            root: Option<serde::de::IgnoredAny>,
        }
        let json = read_file(path)?;
        let place = || path.display().to_string();
        let head: Head = serde_json::from_slice(&json)
            .context("this is no dance as JSON")
            .with_context(place)?;
        if head.rotations.is_none() || head.root.is_none() {
            let problem = "it has no rotations: make it with `--include-rotations`, over HTTP with \
                           `include=rotations`";
            return Err(Usage(format!("{}: {problem}", place())).into());
        }
        let seconds = f64::from(head.frames) / f64::from(head.fps.max(1));
        Ok(Self { json, seconds, song_start_s: head.song_start_s.max(0.0) })
    }
}

impl RenderArgs {
    /// Number of pictures.
    fn frames(&self, dance: &Dance, kind: Kind, fps: u32) -> anyhow::Result<u32> {
        let left = dance.seconds - self.start_s;
        if left <= 0.0 {
            let problem = format!("--start-s: the dance ends at {:.1} s", dance.seconds);
            return Err(Usage(problem).into());
        }
        let seconds = self.duration_s.map_or(left, |wanted| wanted.min(left));
        Ok(match kind {
            Kind::Png => 1,
            Kind::Gif | Kind::Mp4 => (seconds * f64::from(fps)).round().max(1.0) as u32,
        })
    }
}
