//! A character of the caller's own to dance.

use std::path::PathBuf;

use anyhow::Context;
use bailando::formats::{Character, RigLimits, RigMapping};

use super::console::read_file;

/// The caller's own character.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Your own character")]
pub(super) struct RigArgs {
    /// Character or skeleton that dances: .bvh, .glb or .vrm, in its rest pose; the result is the
    /// same file with the dance on its own bones
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "features", "format", "include_rotations", "encoding", "bvh_unit", "skeleton", "mannequin",
        "positions",
    ])]
    rig: Option<PathBuf>,
    /// Which bones are which parts of the body, as --print-mapping writes it; parts that it lacks
    /// are found
    #[arg(long, value_name = "MAP.json", requires = "rig")]
    rig_mapping: Option<PathBuf>,
    /// Print which bones of --rig are taken for which parts of the body, and end
    #[arg(long, requires = "rig")]
    pub(super) print_mapping: bool,
}

impl RigArgs {
    /// Reads the character; none if there is to be none.
    pub(super) fn read(&self) -> anyhow::Result<Option<Character>> {
        let Some(path) = &self.rig else { return Ok(None) };
        let mapping = match &self.rig_mapping {
            None => RigMapping::default(),
            Some(path) => serde_json::from_slice(&read_file(path)?)
                .with_context(|| format!("{}: no mapping of bones", path.display()))?,
        };
        // A file of one's own may be as large as memory allows.
        let limits = RigLimits { bytes: usize::MAX, ..RigLimits::default() };
        let character = Character::read(read_file(path)?, &mapping, &limits);
        character.map(Some).with_context(|| path.display().to_string())
    }
}
