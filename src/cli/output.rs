//! Files and formats of results.

use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;
use bailando::{
    formats::{GeneratedMotion, OutputFormat, RigFormat},
    motion::Positions,
    options::RequestOptions,
};
use clap::{ValueEnum, builder::PossibleValue};
use ndarray_npy::WriteNpyExt;

use super::{
    console::{STANDARD, Usage, write_file},
    inputs::Input,
};

/// How results are written.
#[derive(Debug, clap::Args)]
pub(super) struct OutputArgs {
    /// The file to write; its extension is the format: json, bvh, glb, vrma, fbx, vmd, npz, or npy
    /// (positions alone). `-` is standard output, in --format
    #[arg(short, long, value_name = "OUT.{json,bvh,glb,..}", conflicts_with = "out_dir")]
    output: Option<PathBuf>,
    /// Folder for the results of several songs, each named after its song
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// Format of the files in --out-dir [default: bvh], or of standard output
    #[arg(long, value_enum)]
    format: Option<FileFormat>,
    /// Add local rotations and the root's path to JSON
    #[arg(long)]
    include_rotations: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FileFormat {
    Motion(OutputFormat),
    /// Positions alone.
    Npy,
    /// The file of the caller's own character.
    Rig(RigFormat),
}

impl ValueEnum for FileFormat {
    fn value_variants<'a>() -> &'a [Self] {
        const ALL: [FileFormat; OutputFormat::ALL.len() + 1] = {
            let mut all = [FileFormat::Npy; OutputFormat::ALL.len() + 1];
            let mut index = 0;
            while index < OutputFormat::ALL.len() {
                all[index] = FileFormat::Motion(OutputFormat::ALL[index]);
                index += 1;
            }
            all
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.extension()))
    }
}

impl FileFormat {
    fn extension(self) -> &'static str {
        match self {
            Self::Motion(format) => format.name(),
            Self::Npy => "npy",
            Self::Rig(format) => format.name(),
        }
    }

    /// Returns the format for which the motion is made.
    pub(super) fn motion(self) -> OutputFormat {
        match self {
            Self::Motion(format) => format,
            Self::Npy | Self::Rig(_) => OutputFormat::Bvh,
        }
    }

    fn names() -> String {
        let all: Vec<&str> =
            Self::value_variants().iter().map(|format| format.extension()).collect();
        let (last, others) = all.split_last().unwrap_or((&"", &[]));
        format!("{} or {last}", others.join(", "))
    }

    fn of(path: &Path) -> Result<Self, Usage> {
        let extension = path.extension().and_then(|e| e.to_str());
        let extension = extension.map(str::to_ascii_lowercase);
        let mut formats = Self::value_variants().iter();
        let found = formats.find(|format| extension.as_deref() == Some(format.extension()));
        found.copied().ok_or_else(|| {
            let (path, names) = (path.display(), Self::names());
            Usage(format!("{path}: the extension chooses the format: {names}"))
        })
    }
}

/// Where the result of a song goes, or why it cannot.
pub(super) type Target = Result<(PathBuf, FileFormat), Usage>;

impl OutputArgs {
    /// Chooses one output per input, before any work is done.
    /// They are files of the character `rig` where there is one.
    pub(super) fn targets(
        &self,
        inputs: &[Input],
        rig: Option<RigFormat>,
    ) -> anyhow::Result<Vec<Target>> {
        match (&self.output, &self.out_dir, inputs) {
            (Some(output), None, [_]) => {
                Ok(vec![Ok((output.clone(), self.format_of(output, rig)?))])
            }
            (Some(_), None, _) => {
                Err(Usage("several songs need --out-dir instead of --output".into()).into())
            }
            (_, Some(folder), _) => {
                let format = rig.map(FileFormat::Rig).or(self.format);
                let format = format.unwrap_or(FileFormat::Motion(OutputFormat::Bvh));
                targets_in(folder, format, inputs)
            }
            (None, None, _) => {
                Err(Usage("name the result: --output FILE or --out-dir DIR".into()).into())
            }
        }
    }

    /// The format of the one file to write.
    fn format_of(&self, output: &Path, rig: Option<RigFormat>) -> Result<FileFormat, Usage> {
        if let Some(rig) = rig {
            return rig_format_of(output, rig);
        }
        if output.as_os_str() == STANDARD {
            let problem = || Usage(format!("--output - needs --format: {}", FileFormat::names()));
            return self.format.ok_or_else(problem);
        }
        let named = FileFormat::of(output)?;
        check_folder_of(output)?;
        match self.format {
            Some(asked) if asked != named => Err(Usage(format!(
                "{} would be written as {}, and --format says {}: leave one of them out",
                output.display(),
                named.extension(),
                asked.extension()
            ))),
            _ => Ok(named),
        }
    }

    /// Writes `dance` to `path`.
    pub(super) fn write(
        &self,
        dance: &GeneratedMotion,
        path: &Path,
        format: FileFormat,
        options: &RequestOptions,
    ) -> anyhow::Result<()> {
        let FileFormat::Motion(format) = format else {
            return write_positions(path, &dance.positions);
        };
        let mut writing = options.writing();
        writing.json.rotations = self.include_rotations;
        write_file(path, format.write(dance, &writing)?)
    }
}

/// One file for each song. Of two that would be written to one file, the first has it.
pub(super) fn targets_in(
    folder: &Path,
    format: FileFormat,
    inputs: &[Input],
) -> anyhow::Result<Vec<Target>> {
    let mut songs: HashMap<PathBuf, &Path> = HashMap::new();
    let mut targets = Vec::with_capacity(inputs.len());
    for Input { path, below } in inputs {
        // Appended, not `with_extension`: song names hold dots of their own.
        let mut name = match path.as_os_str() == STANDARD {
            true => "stdin".into(),
            false => path.file_stem().unwrap_or_default().to_os_string(),
        };
        name.push(".");
        name.push(format.extension());
        let place = folder.join(below);
        fs::create_dir_all(&place).with_context(|| place.display().to_string())?;
        let target = place.join(name);
        targets.push(match songs.get(&target) {
            None => Ok((target.clone(), format)),
            Some(other) => Err(Usage(format!(
                "its result would replace that of {}, {}: rename one of the songs",
                other.display(),
                target.display()
            ))),
        });
        songs.entry(target).or_insert(path);
    }
    Ok(targets)
}

/// The format of the one file of a character: its own.
fn rig_format_of(output: &Path, rig: RigFormat) -> Result<FileFormat, Usage> {
    if output.as_os_str() != STANDARD {
        check_folder_of(output)?;
        let extension = output.extension().and_then(|extension| extension.to_str());
        if !extension.is_some_and(|extension| extension.eq_ignore_ascii_case(rig.name())) {
            return Err(Usage(format!(
                "{}: a dance on this character is a .{} file as it is",
                output.display(),
                rig.name()
            )));
        }
    }
    Ok(FileFormat::Rig(rig))
}

/// Checks that a file's folder exists, before hours of work instead of after.
pub(super) fn check_folder_of(file: &Path) -> Result<(), Usage> {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            Err(Usage(format!("{}: there is no such folder", folder.display())))
        }
        _ => Ok(()),
    }
}

/// Writes positions as float32 [frames, joints, 3].
pub(super) fn write_positions(path: &Path, positions: &Positions) -> anyhow::Result<()> {
    let mut bytes = Vec::new();
    positions.write_npy(&mut bytes).with_context(|| path.display().to_string())?;
    write_file(path, bytes)
}
