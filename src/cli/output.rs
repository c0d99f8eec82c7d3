//! Files and formats of results.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;
use bailando::{
    formats::{GeneratedMotion, JsonOptions, OutputFormat},
    motion::Positions,
    options::RequestOptions,
};
use clap::ValueEnum;

use super::console::{Usage, write_file};

/// How results are written.
#[derive(Debug, clap::Args)]
pub(super) struct OutputArgs {
    /// The file to write; its extension is the format: json, bvh or npy (positions alone)
    #[arg(short, long, value_name = "OUT.{json,bvh,npy}", conflicts_with = "out_dir")]
    output: Option<PathBuf>,
    /// Folder for the results of several songs, each named after its song
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// Format of the files in --out-dir
    #[arg(long, value_enum, default_value = "bvh", requires = "out_dir")]
    format: FileFormat,
    /// Add local rotations and the root's path to JSON
    #[arg(long)]
    include_rotations: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum FileFormat {
    Json,
    Bvh,
    Npy,
}

impl FileFormat {
    fn extension(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Bvh => "bvh",
            Self::Npy => "npy",
        }
    }

    fn of(path: &Path) -> Result<Self, Usage> {
        let extension = path.extension().and_then(|e| e.to_str());
        let extension = extension.map(str::to_ascii_lowercase);
        let mut formats = [Self::Json, Self::Bvh, Self::Npy].into_iter();
        formats.find(|format| extension.as_deref() == Some(format.extension())).ok_or_else(|| {
            let path = path.display();
            Usage(format!("{path}: the extension chooses the format: json, bvh or npy"))
        })
    }
}

impl OutputArgs {
    /// Chooses one output per input, before any work is done.
    pub(super) fn targets(&self, inputs: &[PathBuf]) -> anyhow::Result<Vec<(PathBuf, FileFormat)>> {
        match (&self.output, &self.out_dir, inputs) {
            (Some(output), None, [_]) => {
                let format = FileFormat::of(output)?;
                check_folder_of(output)?;
                Ok(vec![(output.clone(), format)])
            }
            (Some(_), None, _) => {
                Err(Usage("several songs need --out-dir instead of --output".into()).into())
            }
            (_, Some(folder), _) => self.targets_in(folder, inputs),
            (None, None, _) => {
                Err(Usage("name the result: --output FILE or --out-dir DIR".into()).into())
            }
        }
    }

    fn targets_in(
        &self,
        folder: &Path,
        inputs: &[PathBuf],
    ) -> anyhow::Result<Vec<(PathBuf, FileFormat)>> {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let mut targets: Vec<(PathBuf, FileFormat)> = Vec::new();
        for input in inputs {
            // Appended, not `with_extension`: song names hold dots of their own.
            let mut name = input.file_stem().unwrap_or_default().to_os_string();
            name.push(".");
            name.push(self.format.extension());
            let target = folder.join(name);
            if targets.iter().any(|(other, _)| *other == target) {
                let name = target.display();
                return Err(Usage(format!("two songs would be written to {name}")).into());
            }
            targets.push((target, self.format));
        }
        Ok(targets)
    }

    /// Writes `dance` to `path`.
    pub(super) fn write(
        &self,
        dance: &GeneratedMotion,
        path: &Path,
        format: FileFormat,
        options: &RequestOptions,
    ) -> anyhow::Result<()> {
        let format = match format {
            FileFormat::Npy => return write_positions(path, &dance.positions),
            FileFormat::Json => OutputFormat::Json,
            FileFormat::Bvh => OutputFormat::Bvh,
        };
        let json = JsonOptions { rotations: self.include_rotations, ..options.json() };
        let bytes = format.write(dance, &json, options.bvh_unit());
        write_file(path, bytes?)
    }
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
    ndarray_npy::write_npy(path, positions).with_context(|| path.display().to_string())
}
