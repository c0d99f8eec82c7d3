//! A whole evaluation: from folders to a report.

use std::{
    num::NonZeroUsize,
    path::{Path, PathBuf},
};

use crate::{
    clips::Clips,
    error::EvaluationError,
    files::{entries, stem},
    kinetic::KineticForm,
    music::{BeatsFrom, MusicBeats, SongForms},
    recitation::TrainingTakes,
    report::{Protocol, Report},
    scores::{Evaluator, ReferenceSpace},
    sets::{MotionSet, Reference, TEST_SPLIT, training_recordings},
    style::StyleRecognition,
};

/// Names listed in a warning before the number of the others.
const LISTED: usize = 6;

/// The inputs and the measuring of an evaluation.
#[derive(Clone, Debug)]
pub struct EvaluationOptions {
    /// Folder of generated motions, or of one folder per seed.
    pub generated: PathBuf,
    /// Data folder, or folder of motions.
    pub reference: PathBuf,
    /// The split that generated pieces are limited to; the reference's row is of this split, or of
    /// `test`.
    pub split: Option<String>,
    /// Source of the music beats.
    pub beats: BeatsFrom,
    /// The samples of distances and diversity.
    pub clips: Clips,
    /// Published or corrected kinetic features.
    pub kinetic: KineticForm,
    /// Number of folders of generated motions; none: `generated` itself is one.
    pub seeds: Option<NonZeroUsize>,
    /// Data folders whose training recordings teach what styles look like; none: styles are not
    /// recognised.
    pub styles_from: Vec<PathBuf>,
    /// The style that all generated motions were asked for; none: that of their pieces.
    pub style: Option<String>,
    /// Whether to measure how far the form of dances agrees with that of their songs, which are
    /// decoded for it.
    pub form: bool,
    /// Seed of the random shifts and orders behind chance levels.
    pub chance_seed: u64,
}

/// Measures generated motions, and the reference's own test pieces, against the reference.
///
/// # Errors
/// [`EvaluationError`] names the file, piece or option that does not fit.
pub fn evaluate(options: &EvaluationOptions) -> Result<Report, EvaluationError> {
    options.clips.check()?;
    let split = options.split.as_deref().unwrap_or(TEST_SPLIT);
    let reference = Reference::load(&options.reference, split)?;
    let mut warnings = Vec::new();
    let sets = generated_sets(options, &reference, split, &mut warnings)?;
    warn_of_short_motions(options.clips, &reference, &sets, &mut warnings);
    let whole = reference.whole.motions();
    let train = reference.train.motions();
    let beats = music_beats(&options.beats, &reference, &sets)?;
    let evaluator = Evaluator {
        forms: song_forms(options, beats.as_ref(), &reference, &sets)?,
        reference: ReferenceSpace::new(whole, options.clips, options.kinetic)?,
        beats,
        takes: (!train.is_empty()).then(|| TrainingTakes::new(train)),
        styles: style_recognition(&options.styles_from)?,
        seed: options.chance_seed,
    };
    let row = evaluator.score("the reference's own pieces", &reference.test)?;
    let scores = sets
        .iter()
        .map(|(folder, set)| evaluator.score(&folder.display().to_string(), set))
        .collect::<Result<_, _>>()?;
    let mut report = Report::new(scores, row, protocol(options, &evaluator), warnings);
    if evaluator.styles.is_some() {
        let own = evaluator.score_by_style(&reference.test);
        let sets = sets.iter().map(|(_, set)| evaluator.score_by_style(set)).collect();
        report.add_styles(own, sets);
    }
    Ok(report)
}

fn protocol(options: &EvaluationOptions, evaluator: &Evaluator) -> Protocol {
    let [kinetic, geometric] = evaluator.reference.constant_columns();
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
        beats: evaluator.beats.as_ref().map(|beats| beats.source),
        reference_samples: evaluator.reference.samples(),
        constant_kinetic_columns: kinetic,
        constant_geometric_columns: geometric,
        chance_seed: options.chance_seed,
    }
}

fn style_recognition(folders: &[PathBuf]) -> Result<Option<StyleRecognition>, EvaluationError> {
    if folders.is_empty() {
        return Ok(None);
    }
    let sets = folders.iter().map(|folder| training_recordings(folder));
    let sets: Vec<MotionSet> = sets.collect::<Result<_, _>>()?;
    let pieces = sets.iter().flat_map(MotionSet::by_style);
    let recordings: Vec<(&str, MotionSet)> = pieces.collect();
    let takes = recordings
        .iter()
        .flat_map(|(style, set)| set.motions().into_iter().map(|motion| (*style, motion.poses())));
    StyleRecognition::new(takes).map(Some)
}

/// A set of motions and its folder.
type NamedSet = (PathBuf, MotionSet);

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
        let mut set = MotionSet::load(&folder, split)?;
        for piece in &mut set.pieces {
            let own = || reference.info(&piece.id).and_then(|info| info.style.clone());
            piece.style = options.style.clone().or_else(own);
        }
        let set = match options.split {
            Some(_) => only_split(set, reference, split, &folder, warnings)?,
            None if matches!(options.beats, BeatsFrom::NewSongs { .. }) => set,
            None => {
                set.pieces.iter().try_for_each(|piece| reference.split_of(&piece.id).map(drop))?;
                set
            }
        };
        sets.push((folder, set));
    }
    Ok(sets)
}

/// Returns the folders directly inside `folder`, one per seed.
fn seed_folders(folder: &Path, seeds: usize) -> Result<Vec<PathBuf>, EvaluationError> {
    let mut folders = entries(folder)?;
    folders.retain(|path| path.is_dir());
    if folders.len() == seeds {
        return Ok(folders);
    }
    let names: Vec<String> = folders.iter().map(|folder| stem(folder)).collect();
    let (found, names) = (names.len(), listed(&names));
    let problem =
        format!("--seeds {seeds} needs {seeds} folders of motions in it, it has {found} ({names})");
    Err(EvaluationError::file(folder, problem))
}

/// Removes the pieces of other splits from a generated set, and warns of pieces that it lacks.
fn only_split(
    set: MotionSet,
    reference: &Reference,
    split: &str,
    folder: &Path,
    warnings: &mut Vec<String>,
) -> Result<MotionSet, EvaluationError> {
    let folder = folder.display();
    let (mut kept, mut left_out) = (MotionSet::default(), Vec::new());
    for piece in set.pieces {
        // A folder without splits has nothing to leave out.
        match reference.split_of(&piece.id)? {
            own if own.is_empty() || own == split => kept.pieces.push(piece),
            _ => left_out.push(piece.id),
        }
    }
    if !left_out.is_empty() {
        let names = listed(&left_out);
        warnings.push(format!("{folder}: not of split {split}, left out: {names}"));
    }
    let wanted = reference.test.pieces.iter().map(|piece| &piece.id);
    let lacking: Vec<String> = wanted.filter(|id| !kept.has(id)).cloned().collect();
    if !lacking.is_empty() {
        let (some, all) = (lacking.len(), reference.test.pieces.len());
        let names = listed(&lacking);
        warnings.push(format!(
            "{folder}: {some} of {all} pieces of split {split} are missing: {names}"
        ));
    }
    Ok(kept)
}

fn listed(names: &[String]) -> String {
    let mut text = names[..names.len().min(LISTED)].join(", ");
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
    let reference = (reference.folder.as_path(), &reference.whole);
    let sets = sets.iter().map(|(folder, set)| (folder.as_path(), set));
    for (folder, set) in std::iter::once(reference).chain(sets) {
        let motions = set.motions().into_iter();
        let short = motions.filter(|motion| motion.poses().len() < length);
        let names: Vec<String> = short.map(|motion| motion.name().to_owned()).collect();
        if !names.is_empty() {
            let (folder, names) = (folder.display(), listed(&names));
            warnings.push(format!("{folder}: shorter than {length} frames, no window: {names}"));
        }
    }
}

fn music_beats(
    from: &BeatsFrom,
    reference: &Reference,
    sets: &[NamedSet],
) -> Result<Option<MusicBeats>, EvaluationError> {
    MusicBeats::find(from, pieces(from, reference, sets), reference)
}

fn song_forms(
    options: &EvaluationOptions,
    beats: Option<&MusicBeats>,
    reference: &Reference,
    sets: &[NamedSet],
) -> Result<Option<SongForms>, EvaluationError> {
    let from = &options.beats;
    match (options.form, beats) {
        (false, _) => Ok(None),
        (true, None) => Err(EvaluationError::Option(
            "the form of songs is found from their beats, and none are given".into(),
        )),
        (true, Some(beats)) => {
            SongForms::find(from, beats, pieces(from, reference, sets), reference).map(Some)
        }
    }
}

/// The pieces that have songs.
fn pieces<'a>(
    from: &BeatsFrom,
    reference: &'a Reference,
    sets: &'a [NamedSet],
) -> impl Iterator<Item = &'a str> {
    // New songs are no pieces of the reference.
    let own = (!matches!(from, BeatsFrom::NewSongs { .. })).then_some(&reference.test);
    let all = own.into_iter().chain(sets.iter().map(|(_, set)| set));
    all.flat_map(|set| set.pieces.iter().map(|piece| piece.id.as_str()))
}
