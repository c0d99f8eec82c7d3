//! The command line: parse, call, print.

mod arguments;

use std::{
    fmt::Display,
    io::{self, Write},
    path::Path,
};

use bailando::model::Manifest;
use serde::Serialize;

pub use self::arguments::Arguments;
use self::arguments::{
    AdaptArguments, Command, GenerateArguments, ReportCommand, StageArguments, StylesArguments,
    WholeArguments,
};
use crate::{
    compare::compare,
    data::{
        check::{CheckOptions, check},
        convert::{ConvertOptions, convert},
    },
    encode::{EncodeOptions, encode},
    import::{ImportOptions, import},
    music_gap::music_gap,
    training::{
        AblationConfig, Adaptation, Limits, MotionSet, Outcome, ServedModel, Stage, StopFlag,
        TrainError, adapt, export, export_adapted, generate_test_motions, learn_styles, run_all,
        target_song, train,
    },
    trial::try_dance,
};

/// The report on a run that a limit ended.
const PAUSED: &str = "paused: the same command resumes";

/// Runs one command and reports on `output`. A stage that trains stops when `stop` is raised.
///
/// # Errors
/// Those of the command or the output, for one line on standard error.
pub fn run(
    arguments: Arguments,
    stop: Option<&'static StopFlag>,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    match arguments.command {
        Command::Import(arguments) => {
            let options = ImportOptions::from(*arguments);
            let manifest = import(&options)?;
            report(&options, &manifest, output)?;
            let trial = try_dance(&options.out).map_err(|error| {
                let out = options.out.display();
                anyhow::anyhow!("{out} was written, but cannot dance: {error}")
            })?;
            writeln!(output, "{trial}")?;
            Ok(try_it(&options.out, output)?)
        }
        Command::Run(arguments) => train_all(&arguments, stop, output),
        Command::VqVae(arguments) => train_stage(Stage::VqVae, &arguments, stop, output),
        Command::Velocity(arguments) => train_stage(Stage::Velocity, &arguments, stop, output),
        Command::Gpt(arguments) => train_stage(Stage::Gpt, &arguments, stop, output),
        Command::ActorCritic(arguments) => {
            train_stage(Stage::ActorCritic, &arguments, stop, output)
        }
        Command::Adapt(arguments) => adapt_policy(&arguments, stop, output),
        Command::Export(arguments) => {
            let config = arguments.settings.read()?;
            let manifest = export(&config, arguments.force)?;
            let folder = config.export.folder.display();
            writeln!(output, "wrote {folder} ({})", manifest.name)?;
            Ok(())
        }
        Command::Encode(arguments) => {
            let (data, options) = arguments.split();
            let options = EncodeOptions { data, ..options };
            let count = encode(&options)?;
            writeln!(output, "wrote {count} recordings to {}", options.out.display())?;
            Ok(())
        }
        Command::Generate(arguments) => generate(&arguments, output),
        Command::MusicGap(ReportCommand { command, json }) => {
            let (data, mut options) = command.split();
            options.recordings.data = data;
            print(&music_gap(&options)?, json, output)
        }
        Command::Compare(ReportCommand { command, json }) => {
            let (data, mut options) = command.split();
            options.recordings.data = data;
            print(&compare(&options)?, json, output)
        }
        Command::Styles(StylesArguments { settings, json }) => {
            let report = learn_styles(&settings.read()?, &mut std::io::sink())?;
            print(&report, json, output)
        }
        Command::Convert(options) => convert_motions(&options, output),
        Command::CheckData(arguments) => check_data(arguments, output),
    }
}

fn train_stage(
    stage: Stage,
    arguments: &StageArguments,
    stop: Option<&'static StopFlag>,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    let config = arguments.settings.read()?;
    let (file, directory) = match &arguments.init {
        Some(path) => (!path.is_dir(), path.is_dir()),
        None => (false, false),
    };
    anyhow::ensure!(
        !(file && stage == Stage::Velocity),
        "velocity takes no file for --init: it starts from the VQ-VAE of the run, or with the \
         root's decoder of a model directory"
    );
    anyhow::ensure!(
        !(directory && stage == Stage::ActorCritic),
        "actor-critic takes no directory for --init: it starts from the GPT of the run"
    );
    let set = MotionSet::read(&config, stage.load(), output)?;
    let (init, limits) = (arguments.init.as_deref(), arguments.limits(stop));
    let outcome = train(stage, &config, &set, init, limits, output)?;
    report_outcome(outcome, output)
}

fn adapt_policy(
    arguments: &AdaptArguments,
    stop: Option<&'static StopFlag>,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    let mut config = arguments.stage.settings.read()?;
    anyhow::ensure!(
        arguments.stage.init.is_none() || config.adapt.candidates == 0,
        "adapt has no --init where the best of some candidates is imitated: there is no critic"
    );
    let model = match &arguments.model {
        Some(model) => Some(ServedModel::open(model)?),
        None if config.adapt.candidates > 0 => Some(ServedModel::of_run(&config)?),
        None => None,
    };
    let mut counts_late_s = 0.0;
    if let Some(model) = &model {
        config = model.settings(config);
        counts_late_s = model.counts_late_s();
    }
    let songs = arguments.songs.iter().map(|path| {
        let song = target_song(&config.data, counts_late_s, path)?;
        Ok::<_, TrainError>((path.clone(), song))
    });
    let adaptation = Adaptation::new(&config, songs.collect::<Result<_, _>>()?, model)?;
    let (init, limits) = (arguments.stage.init.as_deref(), arguments.stage.limits(stop));
    let outcome = adapt(&config, &adaptation, init, limits, output)?;
    report_outcome(outcome, output)?;
    if outcome == Outcome::Paused {
        return Ok(());
    }
    let folder = arguments.out.clone();
    let folder = folder.unwrap_or_else(|| adaptation.folder.join("model"));
    let manifest = export_adapted(&config, &adaptation, &folder, arguments.force)?;
    writeln!(output, "wrote {} ({})", folder.display(), manifest.name)?;
    Ok(())
}

fn generate(arguments: &GenerateArguments, output: &mut impl Write) -> anyhow::Result<()> {
    let config = arguments.settings.read()?;
    let (seed, folder) = (arguments.seed, &arguments.out);
    let count = generate_test_motions(&config, seed, folder, output)?;
    writeln!(output, "wrote {count} motions to {}", folder.display())?;
    Ok(())
}

fn print(
    figures: &(impl Serialize + Display),
    json: bool,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    if json {
        serde_json::to_writer_pretty(&mut *output, figures)?;
        writeln!(output)?;
    } else {
        write!(output, "{figures}")?;
    }
    Ok(())
}

fn report_outcome(outcome: Outcome, output: &mut impl Write) -> anyhow::Result<()> {
    match outcome {
        Outcome::Finished => writeln!(output, "finished")?,
        Outcome::Paused => writeln!(output, "{PAUSED}")?,
    }
    Ok(())
}

fn train_all(
    arguments: &WholeArguments,
    stop: Option<&'static StopFlag>,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    let config = arguments.run.settings.read()?;
    let limits = Limits { seconds: arguments.max_seconds, steps: None, stop };
    let init = arguments.init.as_deref();
    if let Some(path) = init {
        anyhow::ensure!(path.is_dir(), "--init {}: no such model directory", path.display());
    }
    match run_all(&config, arguments.run.force, init, limits, output)? {
        Outcome::Finished if config.ablation == AblationConfig::default() => {
            try_it(&config.export.folder, output)?;
        }
        Outcome::Finished => {}
        Outcome::Paused => writeln!(output, "{PAUSED}")?,
    }
    Ok(())
}

fn try_it(model: &Path, output: &mut impl Write) -> io::Result<()> {
    let model = model.display();
    writeln!(output, "try it: bailando serve --model-dir {model}")
}

fn convert_motions(options: &ConvertOptions, output: &mut impl Write) -> anyhow::Result<()> {
    let done = convert(options)?;
    for error in &done.refused {
        writeln!(output, "left out: {error}")?;
    }
    let (out, refused) = (options.out.display(), done.refused.len());
    if done.motions > 0 {
        writeln!(output, "wrote {} motions to {out}, {} with songs", done.motions, done.songs)?;
        writeln!(output, "next: bailando-train check-data {out}")?;
    }
    anyhow::ensure!(refused == 0, "{out}: {refused} motions were left out");
    Ok(())
}

fn check_data(
    arguments: ReportCommand<CheckOptions>,
    output: &mut impl Write,
) -> anyhow::Result<()> {
    let (folder, options) = arguments.command.split();
    let report = check(&folder, &options)?;
    print(&report, arguments.json, output)?;
    if report.is_usable() {
        return Ok(());
    }
    anyhow::bail!("{}: {}", folder.display(), report.verdict())
}

fn report(options: &ImportOptions, manifest: &Manifest, output: &mut impl Write) -> io::Result<()> {
    let gpt = manifest.gpt;
    writeln!(output, "wrote {} ({})", options.out.display(), manifest.name)?;
    writeln!(
        output,
        "  {} upper and {} lower codes; GPT of {} layers, {} channels, {} heads; decoder of width \
         {}",
        manifest.vocabulary.upper,
        manifest.vocabulary.lower,
        gpt.layers,
        gpt.channels,
        gpt.heads,
        manifest.decoder.width,
    )?;
    for (name, file) in &manifest.files {
        writeln!(output, "  {name:<13} {:>8.1} MB", file.bytes as f64 / 1e6)?;
    }
    Ok(())
}
