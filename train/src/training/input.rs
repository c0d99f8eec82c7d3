//! Motions in memory, as the stages learn from them; the two splits are of different types.

use std::{collections::BTreeSet, io::Write, marker::PhantomData};

use bailando::{model::check_styles, motion::MotionFrame};

use super::{
    config::Config,
    error::TrainError,
    piece::{MotionPiece, PieceFacts},
    song::{Song as Target, training_songs},
    songs::{MusicRows, SongRows, known_counts, song_rows},
    stage::Load,
};
use crate::data::{
    Choice, DataError, Dataset, Draw, Evaluation, Portion, Recording, Song, SplitKind, Training,
    crop_starts, quantised,
};

/// The motions of one split. A function of `Motions<Training>` cannot be given test motions.
#[derive(Clone, Debug)]
pub struct Motions<S> {
    pieces: Vec<MotionPiece>,
    split: PhantomData<S>,
}

impl<S: SplitKind> Motions<S> {
    /// Takes motions of the split.
    #[must_use]
    pub fn new(pieces: Vec<MotionPiece>) -> Self {
        Self { pieces, split: PhantomData }
    }

    /// Returns the motions; [`Draw::dance`] is a place in them.
    #[must_use]
    pub fn pieces(&self) -> &[MotionPiece] {
        &self.pieces
    }

    fn read(
        portion: &Portion<S>,
        (frame, quantise_frames): (MotionFrame, usize),
        styles: &[String],
        rows: Option<&MusicRows>,
    ) -> Result<Self, TrainError> {
        let mut pieces = Vec::with_capacity(portion.recordings().len());
        for dance in portion.recordings() {
            let songs = |rows: &MusicRows| -> Vec<SongRows> {
                let songs = dance.songs().iter();
                let rows = songs.filter_map(|song| rows.get(song.music.as_ref()?));
                rows.cloned().collect()
            };
            let songs = rows.map(songs).unwrap_or_default();
            if rows.is_some() && songs.is_empty() {
                continue;
            }
            let path = dance.source().path();
            let failed = |message: String| TrainError::Data { path: path.to_owned(), message };
            let motion = dance.motion(portion.skeleton())?;
            if motion.positions().iter().any(|value| !value.is_finite()) {
                return Err(failed("holds values that are no numbers".into()));
            }
            let motion = match quantise_frames {
                0 => motion,
                most => quantised(&motion, &dance.counts_s(), most),
            };
            let piece = MotionPiece::from_positions(motion.into_positions(), frame);
            let piece = piece.map_err(|error| failed(error.to_string()))?;
            let piece = piece.with_facts(facts(dance, styles));
            pieces.push(songs.into_iter().fold(piece, MotionPiece::with_song));
        }
        Ok(Self::new(pieces))
    }
}

fn facts<S>(recording: &Recording<S>, styles: &[String]) -> PieceFacts {
    let marks = recording.marks().clone();
    let style = styles.iter().position(|style| Some(style) == marks.style.as_ref());
    let grid_beats_s = recording.grid_beats_s().to_vec();
    PieceFacts { weight: recording.weight(), style, marks, grid_beats_s }
}

/// Returns the names of the styles of a portion, ascending.
pub(super) fn style_names<S: SplitKind>(portion: &Portion<S>) -> Vec<String> {
    let styles = portion.recordings().iter().filter_map(|dance| dance.marks().style.clone());
    styles.collect::<BTreeSet<_>>().into_iter().collect()
}

impl Motions<Training> {
    /// Returns the numbers of motions, frames and songs: a run with other data is not resumed.
    pub(super) fn amount(&self) -> [usize; 3] {
        let frames = self.pieces.iter().map(MotionPiece::frames).sum();
        let songs = self.pieces.iter().map(|piece| piece.songs().len()).sum();
        [self.pieces.len(), frames, songs]
    }

    /// Returns the choices of each motion where music does not matter.
    pub(super) fn motion_choices(&self, phases: usize) -> Vec<Choice> {
        let choice =
            |piece: &MotionPiece| Choice { frames: piece.frames(), skipped: 0, songs: 0, phases };
        self.pieces.iter().map(choice).collect()
    }

    /// Returns the choices of each motion with one of its songs.
    pub(super) fn music_choices(&self, phases: usize) -> Vec<Choice> {
        let choice = |piece: &MotionPiece| Choice {
            frames: piece.frames_with_music(),
            skipped: 0,
            songs: piece.songs().len(),
            phases: piece.phases(phases),
        };
        self.pieces.iter().map(choice).collect()
    }
}

impl Motions<Evaluation> {
    /// Returns the fixed crops of test losses: all of them, without augmentation.
    pub(super) fn crops(&self, length: usize) -> Vec<Draw> {
        let pieces = self.pieces.iter().enumerate();
        let crops = pieces.flat_map(|(dance, piece)| {
            let starts = crop_starts(piece.frames(), length, length);
            starts.map(move |start| fixed(dance, 0, start))
        });
        crops.collect()
    }

    /// Returns the fixed crops of each motion, with one of its songs after the other: seven songs
    /// for one motion must not make it seven times as important.
    pub(super) fn crops_with_music(&self, length: usize, stride: usize) -> Vec<Draw> {
        let mut crops = Vec::new();
        for (dance, piece) in self.pieces.iter().enumerate() {
            let songs = (0..piece.songs().len()).cycle();
            let starts = crop_starts(piece.frames_with_music(), length, stride);
            crops.extend(starts.zip(songs).map(|(start, song)| fixed(dance, song, start)));
        }
        crops
    }
}

fn fixed(dance: usize, song: usize, start: usize) -> Draw {
    Draw { dance, song, start, ..Draw::default() }
}

/// The data of a run: for training and for test losses.
#[derive(Clone, Debug)]
pub struct MotionSet {
    /// For training.
    pub training: Motions<Training>,
    /// For test losses alone.
    pub test: Option<Motions<Evaluation>>,
    /// Songs for which a policy generates motion in training ([`Load::Songs`]).
    pub songs: Vec<Target>,
    /// Names of the styles of the training motions, ascending.
    pub styles: Vec<String>,
}

impl MotionSet {
    /// Takes motions of both splits; without songs for rewards.
    #[must_use]
    pub fn new(training: Motions<Training>, test: Option<Motions<Evaluation>>) -> Self {
        Self { training, test, songs: Vec::new(), styles: Vec::new() }
    }

    /// Reads the data folders, of any layout.
    ///
    /// # Errors
    /// [`TrainError`] names the first file that cannot be used.
    pub fn read(config: &Config, load: Load, output: &mut impl Write) -> Result<Self, TrainError> {
        let data = &config.data;
        let dataset = Dataset::open_all(&data.all_folders(), &data.open_options())?;
        let training = dataset.training()?;
        let test = match dataset.evaluation() {
            Err(DataError::Empty { .. }) => None,
            test => Some(test?),
        };
        let rows = match load {
            Load::Motion | Load::Songs => None,
            Load::Music => {
                let songs = |songs: &[Song]| -> Vec<_> {
                    songs.iter().filter_map(|song| song.music.clone()).collect()
                };
                let mut wanted = Vec::new();
                for dance in training.recordings() {
                    wanted.extend(
                        songs(dance.songs()).into_iter().map(|song| (song, config.gpt_phases())),
                    );
                }
                for dance in test.iter().flat_map(Portion::recordings) {
                    wanted.extend(songs(dance.songs()).into_iter().map(|song| (song, 1)));
                }
                Some(song_rows(data, wanted, &known_counts(data, &training), output)?)
            }
        };
        let quantise_frames = match load {
            Load::Music => config.gpt.quantise_frames,
            Load::Motion | Load::Songs => 0,
        };
        let styles = style_names(&training);
        let failed = |message: String| {
            let path = data.all_folders().swap_remove(0).path;
            TrainError::Data { path, message }
        };
        if config.gpt.styles && styles.is_empty() {
            return Err(failed("gpt.styles: no training motion has a style".into()));
        }
        if config.gpt.styles {
            check_styles(&styles).map_err(failed)?;
        }
        let rows = rows.as_ref();
        let set = Self {
            training: Motions::read(&training, (data.frame, quantise_frames), &styles, rows)?,
            test: match test {
                Some(test) => Some(Motions::read(&test, (data.frame, 0), &styles, rows)?),
                None => None,
            },
            songs: match load {
                Load::Songs => training_songs(data, &training)?,
                _ => Vec::new(),
            },
            styles,
        };
        match set.training.pieces.is_empty() {
            true => Err(failed("no motion of the training split has music".into())),
            false => Ok(set),
        }
    }
}
