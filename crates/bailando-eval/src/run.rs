//! A whole evaluation: from folders to a report.

use std::{
    num::NonZeroUsize,
    path::{Path, PathBuf},
};

use super::{
    EvaluationError,
    clips::Clips,
    kinetic::KineticForm,
    load::{entries, stem},
    music::MusicBeats,
    recitation::Repertoire,
    reference::{DanceSet, Reference, TEST_SPLIT},
    report::{Protocol, Report},
    scores::{Judge, Ruler},
};

/// Names listed in a warning before it says how many more there are.
const LISTED: usize = 6;

/// Where music beats are to come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum BeatsFrom {
    /// The counts of the reference, where it is a data folder that has them.
    #[default]
    Reference,
    /// A JSON file of frames by name.
    File(PathBuf),
    /// A folder of audio files.
    Audio(PathBuf),
    /// The same, for songs that are no pieces of the reference; its own row has no beats then.
    NewSongs(PathBuf),
}

/// What to evaluate, and how.
#[derive(Clone, Debug)]
pub struct EvaluationOptions {
    /// Folder of generated motions, or of one folder per seed.
    pub generated: PathBuf,
    /// Data folder, or folder of motions.
    pub reference: PathBuf,
    /// The split that generated pieces are limited to; the reference's row is of this split, or of
    /// `test`.
    pub split: Option<String>,
    /// Where music beats come from.
    pub beats: BeatsFrom,
    /// What the samples of distances and diversity are.
    pub clips: Clips,
    /// Published or corrected kinetic features.
    pub kinetic: KineticForm,
    /// How many folders of generated motions there are; none: `generated` itself is one.
    pub seeds: Option<NonZeroUsize>,
    /// Seed of the random shifts behind the chance level.
    pub chance_seed: u64,
}

/// Measures generated dances, and the reference's own test pieces, against the reference.
///
/// # Errors
/// [`EvaluationError`] says which file, piece or option does not fit.
pub fn evaluate(options: &EvaluationOptions) -> Result<Report, EvaluationError> {
    options.clips.check()?;
    let split = options.split.as_deref().unwrap_or(TEST_SPLIT);
    let reference = Reference::load(&options.reference, split)?;
    let mut warnings = Vec::new();
    let sets = generated_sets(options, &reference, split, &mut warnings)?;
    warn_of_short_motions(options.clips, &reference, &sets, &mut warnings);
    let judge = Judge {
        ruler: Ruler::new(&reference.whole.motions, options.clips, options.kinetic)?,
        beats: music_beats(options, &reference, &sets)?,
        repertoire: (!reference.train.motions.is_empty())
            .then(|| Repertoire::new(&reference.train.motions)),
        seed: options.chance_seed,
    };
    let row = judge.score("the reference's own pieces", &reference.test)?;
    let scores: Result<Vec<_>, _> = sets
        .iter()
        .map(|(folder, set)| judge.score(&folder.display().to_string(), set))
        .collect();
    Ok(Report::new(
        scores?,
        row,
        protocol(options, &judge),
        warnings,
    ))
}

fn protocol(options: &EvaluationOptions, judge: &Judge) -> Protocol {
    let [kinetic, geometric] = judge.ruler.constant_columns().map(<[usize]>::to_vec);
    Protocol {
        clips: match options.clips {
            Clips::First(frames) => format!("the first {frames} frames of each motion"),
            Clips::Windows { length, stride } => {
                format!("windows of {length} frames every {stride}")
            }
        },
        kinetic: match options.kinetic {
            KineticForm::Published => "published",
            KineticForm::Corrected => "corrected (not comparable with published figures)",
        },
        beats: judge.beats.as_ref().map(|beats| beats.source.to_string()),
        reference_samples: judge.ruler.samples(),
        constant_kinetic_columns: kinetic,
        constant_geometric_columns: geometric,
        chance_seed: options.chance_seed,
    }
}

type NamedSet = (PathBuf, DanceSet);

fn generated_sets(
    options: &EvaluationOptions,
    reference: &Reference,
    split: &str,
    warnings: &mut Vec<String>,
) -> Result<Vec<NamedSet>, EvaluationError> {
    let folders = match options.seeds {
        None => vec![options.generated.clone()],
        Some(seeds) => seed_folders(&options.generated, seeds.get())?,
    };
    let mut sets = Vec::with_capacity(folders.len());
    for folder in folders {
        let set = DanceSet::load(&folder, split)?;
        let set = match options.split {
            Some(_) => only_split(set, reference, split, &folder, warnings)?,
            None if matches!(options.beats, BeatsFrom::NewSongs(_)) => set,
            None => {
                set.pieces
                    .iter()
                    .try_for_each(|piece| reference.split_of(&piece.id).map(drop))?;
                set
            }
        };
        sets.push((folder, set));
    }
    Ok(sets)
}

/// The folders directly inside `folder`, one per seed.
fn seed_folders(folder: &Path, seeds: usize) -> Result<Vec<PathBuf>, EvaluationError> {
    let folders: Vec<PathBuf> = entries(folder)?
        .into_iter()
        .filter(|path| path.is_dir())
        .collect();
    if folders.len() == seeds {
        return Ok(folders);
    }
    let names: Vec<String> = folders.iter().map(|folder| stem(folder)).collect();
    Err(EvaluationError::File {
        path: folder.to_owned(),
        problem: format!(
            "--seeds {seeds} needs {seeds} folders of motions in it, it has {} ({})",
            names.len(),
            listed(&names)
        ),
    })
}

/// A generated set without the pieces of other splits, and a warning about pieces it lacks.
fn only_split(
    set: DanceSet,
    reference: &Reference,
    split: &str,
    folder: &Path,
    warnings: &mut Vec<String>,
) -> Result<DanceSet, EvaluationError> {
    let DanceSet { motions, pieces } = set;
    let mut left_out = Vec::new();
    let mut kept = Vec::new();
    for piece in pieces {
        // A folder without splits has nothing to leave out.
        match reference.split_of(&piece.id)? {
            "" => kept.push(piece),
            own if own == split => kept.push(piece),
            _ => left_out.push(piece.id),
        }
    }
    if !left_out.is_empty() {
        let names = listed(&left_out);
        warnings.push(format!(
            "{}: not of split {split}, left out: {names}",
            folder.display()
        ));
    }
    let lacking: Vec<String> = reference
        .test
        .pieces
        .iter()
        .filter(|piece| kept.iter().all(|other| other.id != piece.id))
        .map(|piece| piece.id.clone())
        .collect();
    if !lacking.is_empty() {
        let (some, all) = (lacking.len(), reference.test.pieces.len());
        warnings.push(format!(
            "{}: {some} of {all} pieces of split {split} are missing: {}",
            folder.display(),
            listed(&lacking)
        ));
    }
    // Motions nobody dances to any more must not count.
    let mut renumbered = vec![None; motions.len()];
    let mut set = DanceSet::default();
    for (at, motion) in motions.into_iter().enumerate() {
        if kept.iter().any(|piece| piece.motion == at) {
            renumbered[at] = Some(set.motions.len());
            set.motions.push(motion);
        }
    }
    for mut piece in kept {
        if let Some(Some(motion)) = renumbered.get(piece.motion) {
            piece.motion = *motion;
            set.pieces.push(piece);
        }
    }
    Ok(set)
}

fn listed(names: &[String]) -> String {
    let mut text = names
        .iter()
        .take(LISTED)
        .cloned()
        .collect::<Vec<_>>()
        .join(", ");
    if names.len() > LISTED {
        text.push_str(&format!(" and {} more", names.len() - LISTED));
    }
    text
}

/// A window has no tail, so that a shorter motion has no sample at all.
fn warn_of_short_motions(
    clips: Clips,
    reference: &Reference,
    sets: &[NamedSet],
    warnings: &mut Vec<String>,
) {
    let Clips::Windows { length, .. } = clips else {
        return;
    };
    let reference = (reference.folder(), &reference.whole);
    let sets = sets.iter().map(|(folder, set)| (folder.as_path(), set));
    for (folder, set) in std::iter::once(reference).chain(sets) {
        let short = set
            .motions
            .iter()
            .filter(|motion| motion.poses().len() < length);
        let names: Vec<String> = short.map(|motion| motion.name().to_owned()).collect();
        if !names.is_empty() {
            let names = listed(&names);
            let folder = folder.display();
            warnings.push(format!(
                "{folder}: shorter than {length} frames, no window: {names}"
            ));
        }
    }
}

fn music_beats(
    options: &EvaluationOptions,
    reference: &Reference,
    sets: &[NamedSet],
) -> Result<Option<MusicBeats>, EvaluationError> {
    let own = std::iter::once(&reference.test)
        .filter(|_| !matches!(options.beats, BeatsFrom::NewSongs(_)));
    let all = own.chain(sets.iter().map(|(_, set)| set));
    let pieces = all.flat_map(|set| set.pieces.iter().map(|piece| piece.id.as_str()));
    match &options.beats {
        BeatsFrom::File(path) => MusicBeats::from_file(path, pieces, reference).map(Some),
        BeatsFrom::Audio(folder) | BeatsFrom::NewSongs(folder) => {
            MusicBeats::from_audio(folder, pieces, reference).map(Some)
        }
        BeatsFrom::Reference => Ok(MusicBeats::from_grid(pieces, reference)),
    }
}
