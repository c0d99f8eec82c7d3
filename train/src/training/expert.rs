//! The expert of an adaptation: the served model with a choice among candidates for each phrase.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::Write,
    path::Path,
};

use bailando::{
    engine::{Engine, EngineConfig, EngineError, GenerationOptions, GenerationRequest, MAX_SEED},
    model::MAX_CANDIDATES,
};
use serde::{Deserialize, Serialize};

use super::{config::AdaptConfig, error::TrainError, files::replace_file, served::ServedModel};

/// Dances to a song.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ExpertDances {
    /// The style that the song is danced in, from a model with styles.
    pub(super) style: Option<String>,
    /// Upper and lower codes of each.
    pub(super) codes: Vec<[Vec<i32>; 2]>,
}

impl ExpertDances {
    /// Returns the pairs of codes that they begin with, each once.
    pub(super) fn starts(&self) -> Vec<[u32; 2]> {
        let starts = self.codes.iter().filter_map(|[upper, lower]| {
            Some([*upper.first()?, *lower.first()?].map(|code| code as u32))
        });
        let starts: BTreeSet<[u32; 2]> = starts.collect();
        starts.into_iter().collect()
    }

    /// Returns these as those of their style; nothing where it is none of `styles`.
    pub(super) fn style_starts(&self, styles: &[String]) -> BTreeMap<String, Vec<[u32; 2]>> {
        let style = self.style.as_ref().filter(|style| styles.contains(style));
        style.map(|style| (style.clone(), self.starts())).into_iter().collect()
    }
}

/// Makes the dances to the song at `path` with `model`, or reads those that an interrupted
/// adaptation has left in `folder` under the song's `name`. Their seeds follow `seed`.
///
/// # Errors
/// [`TrainError`]: the song cannot be danced to, or a file cannot be read or written.
pub(super) fn expert_dances(
    settings: &AdaptConfig,
    (model, folder): (&ServedModel, &Path),
    (path, name): (&Path, &str),
    seed: u64,
    output: &mut impl Write,
) -> Result<ExpertDances, TrainError> {
    let AdaptConfig { dances, candidates, .. } = settings;
    let name = format!("{name}-{dances}-dances-of-{candidates}-candidates-seed-{seed}.json");
    let file = folder.join(name);
    if file.exists() {
        let text = fs::read(&file).map_err(TrainError::file(&file))?;
        let known = serde_json::from_slice(&text);
        return known.map_err(|error| TrainError::state(&file)(error.to_string()));
    }
    let song = fs::read(path).map_err(TrainError::file(path))?;
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |error: EngineError| TrainError::Data { path, message: error.to_string() }
    };
    // Guidance takes two rows of the batch for each candidate.
    let config = EngineConfig { batch: 2 * MAX_CANDIDATES, ..EngineConfig::new(model.root()) };
    let engine = Engine::open(&config).map_err(failed(model.root()))?;
    let mut made = ExpertDances { style: None, codes: Vec::with_capacity(*dances) };
    for dance in 0..*dances as u64 {
        let options = GenerationOptions {
            seed: Some(seed.wrapping_add(dance) % MAX_SEED),
            // There is nothing to choose among where the likeliest code is taken.
            temperature: Some(model.temperature()),
            candidates: Some(*candidates),
            ..GenerationOptions::default()
        };
        let request = GenerationRequest::audio(song.clone(), options);
        let found = engine.generate(request).map_err(failed(path))?;
        let half = |codes: Vec<u32>| codes.into_iter().map(|code| code as i32).collect();
        made.codes.push([half(found.codes.upper), half(found.codes.lower)]);
        made.style = found.style;
        // Progress that cannot be shown is no reason to stop.
        let _ = writeln!(output, "{}: dance {}/{dances}", path.display(), dance + 1);
    }
    fs::create_dir_all(folder).map_err(TrainError::file(folder))?;
    let text =
        serde_json::to_vec(&made).map_err(|error| TrainError::state(&file)(error.to_string()))?;
    replace_file(&file, &text).map_err(TrainError::file(&file))?;
    Ok(made)
}
