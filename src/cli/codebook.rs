//! `bailando codebook`: pictures and numbers of a model's pose codes.

use std::{fs, num::NonZeroUsize, path::PathBuf};

use anyhow::Context;
use bailando::{
    codebook::{Catalogue, Half, MEMORY_FILE, Memory, Order, Uses},
    model::ModelDirectory,
};
use clap::ValueEnum;

use super::{
    codes::read_codes,
    console::{at_least_one, say, write_file},
};

/// Draw each pose code of a model
#[derive(Debug, clap::Args)]
pub(super) struct CodebookArgs {
    /// Model directory
    #[arg(long, env = "BAILANDO_MODEL_DIR", default_value = "models/default")]
    model_dir: PathBuf,
    /// Folder for upper.svg, lower.svg, pairs.svg, codebook.json and index.html; with --codes also
    /// memory.json, from which a model directory that has it tells of its training
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Figures in a row
    #[arg(
        long,
        default_value = "12",
        value_name = "N",
        value_parser = at_least_one::<NonZeroUsize>
    )]
    columns: NonZeroUsize,
    /// Changes from one pair of codes to another to draw: the most frequent in --codes, else those
    /// between the model's start codes, else between codes drawn evenly
    #[arg(long, default_value_t = 12, value_name = "N")]
    pairs: usize,
    /// Count how often these files use each code: JSON of dances, or int64 [2, codes], as
    /// `bailando generate --codes-out` writes them
    #[arg(long, num_args = 1.., value_name = "C.npy")]
    codes: Vec<PathBuf>,
    /// Order of the codes: by number, or the most used in --codes first
    #[arg(long, value_enum, default_value = "number", requires_if("uses", "codes"))]
    sort: SortArg,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SortArg {
    Number,
    Uses,
}

pub(super) fn run(args: &CodebookArgs) -> anyhow::Result<()> {
    let directory = ModelDirectory::open(&args.model_dir)?;
    let uses = args.uses(&directory)?;
    let threads = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let catalogue = Catalogue::new(&directory, threads, uses.as_ref(), args.pairs)?;
    let columns = u32::try_from(args.columns.get()).unwrap_or(u32::MAX);
    let order = match args.sort {
        SortArg::Number => Order::Number,
        SortArg::Uses => Order::Uses,
    };
    let json = serde_json::to_string(&catalogue)?;
    let mut files = vec![
        ("upper.svg", catalogue.sheet(Half::Upper, columns, order)?),
        ("lower.svg", catalogue.sheet(Half::Lower, columns, order)?),
        ("codebook.json", json),
        ("index.html", catalogue.page(columns, order)?),
    ];
    if !catalogue.transitions.is_empty() {
        files.push(("pairs.svg", catalogue.transitions_sheet()?));
    }
    if let Some(uses) = &uses {
        let memory = Memory::new(uses, directory.manifest_sha256());
        files.push((MEMORY_FILE, serde_json::to_string(&memory)?));
    }
    let folder = &args.output;
    fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    for (name, text) in files {
        write_file(&folder.join(name), text)?;
    }
    say(&format!(
        "{}: {} upper and {} lower codes, {} changes",
        folder.join("index.html").display(),
        catalogue.upper.codes.len(),
        catalogue.lower.codes.len(),
        catalogue.transitions.len()
    ));
    Ok(())
}

impl CodebookArgs {
    fn uses(&self, directory: &ModelDirectory) -> anyhow::Result<Option<Uses>> {
        if self.codes.is_empty() {
            return Ok(None);
        }
        let mut uses = Uses::new(directory.manifest().vocabulary);
        for path in &self.codes {
            let codes = read_codes(path)?;
            uses.add(&codes).with_context(|| path.display().to_string())?;
        }
        Ok(Some(uses))
    }
}
