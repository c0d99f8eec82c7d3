//! Motions in memory, as the stages learn from them; the two splits are of different types.

use std::{io::Write, marker::PhantomData, ops::Range};

use bailando::motion::{
    MotionError, MotionFrame, Positions, joint_speed, slow_share, to_dancer_frame,
};
use ndarray::Array2;

use super::{
    config::Config,
    error::TrainError,
    song::{Song as Target, training_songs},
    songs::{MusicRows, SongRows, song_rows},
    stage::Load,
};
use crate::data::{
    Choice, DataError, Dataset, Draw, Evaluation, FPS, Motion, OpenOptions, Portion, Song,
    SplitKind, Training, common_frames, crop_starts, mirrored_column, quantised,
};

/// A motion and the songs that go with it.
#[derive(Clone, Debug)]
pub struct MotionPiece {
    /// `[frames, 72]` at 60 fps: the root's velocity (metres per frame) in columns 0..2, the other
    /// joints relative to the root, as the decoder gives them (ARCHITECTURE section 2); in the
    /// dancer's frame `[frames, 73]`, turned, with the turn in the last column.
    motion: Array2<f32>,
    songs: Vec<SongRows>,
    /// Frames without those in which the dancer stands at the start and at the end.
    dancing: Range<usize>,
}

/// Frames at either end of a recording in which the dancer may stand ready.
const EDGE: usize = 5 * FPS;

impl MotionPiece {
    /// Takes joints in world space, `[frames, 24, 3]` metres; without songs.
    ///
    /// # Errors
    /// [`MotionError::Shape`] for other joints.
    pub fn from_positions(positions: Positions, frame: MotionFrame) -> Result<Self, MotionError> {
        let motion = Motion::new(positions);
        let decoded = motion.decoded();
        let dancing = dancing(&decoded);
        let columns = match frame {
            MotionFrame::Dancer => to_dancer_frame(motion.positions())?,
            MotionFrame::World => decoded,
        };
        Ok(Self { motion: columns, songs: Vec::new(), dancing })
    }

    /// Adds a song.
    #[must_use]
    pub fn with_song(mut self, song: SongRows) -> Self {
        self.songs.push(song);
        self
    }

    /// Returns the frames between the last slow frame of the first five seconds and the first slow
    /// frame of the last five.
    pub(super) fn dancing(&self) -> Range<usize> {
        self.dancing.clone()
    }

    /// Returns the number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.motion.nrows()
    }

    /// Returns the songs.
    #[must_use]
    pub fn songs(&self) -> &[SongRows] {
        &self.songs
    }

    /// Returns the number of frames that have music with every song.
    pub(super) fn frames_with_music(&self) -> usize {
        let rows = self.songs.iter().map(|song| song.phase(0).nrows()).min();
        common_frames(self.frames(), rows.unwrap_or(0))
    }

    /// Returns the number of start phases, at most `wanted`, for which all of its songs have rows.
    pub(super) fn phases(&self, wanted: usize) -> usize {
        let known = self.songs.iter().map(|song| song.phases()).min();
        known.map_or(wanted, |known| known.min(wanted)).max(1)
    }

    /// Returns a value of the motion or of its mirror image.
    pub(super) fn value(&self, frame: usize, column: usize, mirrored: bool) -> f32 {
        if !mirrored {
            return self.motion[[frame, column]];
        }
        let (source, factor) = mirrored_column(column);
        factor * self.motion[[frame, source]]
    }
}

/// See [`MotionPiece::dancing`]; takes motion as a decoder gives it.
fn dancing(decoded: &Array2<f32>) -> Range<usize> {
    let speed = joint_speed(decoded.view());
    let slow = |&step: &f64| slow_share(&[step], FPS as f64) > 0.0;
    let begins = speed.iter().take(EDGE).rposition(slow).map_or(0, |last| last + 1);
    let ends = speed.iter().rev().take(EDGE).rposition(slow);
    let ends = ends.map_or(decoded.nrows(), |from_the_end| speed.len() - 1 - from_the_end);
    begins..ends.max(begins)
}

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
        frame: MotionFrame,
        quantise_frames: usize,
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
                most => quantised(&motion, dance.grid_beats_s(), most),
            };
            let piece = MotionPiece::from_positions(motion.into_positions(), frame);
            let piece = piece.map_err(|error| failed(error.to_string()))?;
            pieces.push(MotionPiece { songs, ..piece });
        }
        Ok(Self::new(pieces))
    }
}

impl Motions<Training> {
    /// Returns the numbers of motions, frames and songs: a run with other data is not resumed.
    pub(super) fn amount(&self) -> [usize; 3] {
        let frames = self.pieces.iter().map(MotionPiece::frames).sum();
        let songs = self.pieces.iter().map(|piece| piece.songs.len()).sum();
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
            songs: piece.songs.len(),
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

    /// Returns the fixed crops of each motion with each of its songs.
    pub(super) fn crops_with_music(&self, length: usize, stride: usize) -> Vec<Draw> {
        let mut crops = Vec::new();
        for (dance, piece) in self.pieces.iter().enumerate() {
            for song in 0..piece.songs.len() {
                let starts = crop_starts(piece.frames_with_music(), length, stride);
                crops.extend(starts.map(|start| fixed(dance, song, start)));
            }
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
}

impl MotionSet {
    /// Takes motions of both splits; without songs for rewards.
    #[must_use]
    pub fn new(training: Motions<Training>, test: Option<Motions<Evaluation>>) -> Self {
        Self { training, test, songs: Vec::new() }
    }

    /// Reads a data folder of any layout.
    ///
    /// # Errors
    /// [`TrainError`] names the first file that cannot be used.
    pub fn read(config: &Config, load: Load, output: &mut impl Write) -> Result<Self, TrainError> {
        let data = &config.data;
        let options = OpenOptions { audio: data.audio_folder().map(Into::into) };
        let dataset = Dataset::open(&data.folder, &options)?;
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
                Some(song_rows(data, wanted, output)?)
            }
        };
        let quantise_frames = match load {
            Load::Music => config.gpt.quantise_frames,
            Load::Motion | Load::Songs => 0,
        };
        let set = Self {
            training: Motions::read(&training, data.frame, quantise_frames, rows.as_ref())?,
            test: match test {
                Some(test) => Some(Motions::read(&test, data.frame, 0, rows.as_ref())?),
                None => None,
            },
            songs: match load {
                Load::Songs => training_songs(data, &training)?,
                _ => Vec::new(),
            },
        };
        if set.training.pieces.is_empty() {
            return Err(TrainError::Data {
                path: data.folder.clone(),
                message: "no motion of the training split has music".into(),
            });
        }
        Ok(set)
    }
}
