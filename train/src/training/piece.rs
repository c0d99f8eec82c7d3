//! A motion in memory, with its songs and what the data say about it.

use std::ops::Range;

use bailando::motion::{
    MotionError, MotionFrame, Positions, joint_speed, slow_share, to_dancer_frame,
};
use ndarray::Array2;

use super::{feet::contacts, songs::SongRows};
use crate::data::{FPS, Marks, Motion, common_frames, mirrored_column};

/// A motion and the songs that go with it.
#[derive(Clone, Debug)]
pub struct MotionPiece {
    /// `[frames, 72]` at 60 fps: the root's velocity (metres per frame) in columns 0..2, the other
    /// joints relative to the root, as the decoder gives them (ARCHITECTURE section 2); in the
    /// dancer's frame `[frames, 73]`, turned, with the turn in the last column.
    motion: Array2<f32>,
    songs: Vec<SongRows>,
    /// Mean speed of the joints from each frame to the next, metres a frame.
    speed: Vec<f64>,
    /// Whether the feet stand from each frame to the next.
    contacts: Vec<[bool; 2]>,
    facts: PieceFacts,
}

/// What the data say about a motion.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PieceFacts {
    /// Weight of its data folder.
    pub(super) weight: f64,
    /// Place of its style in [`MotionSet::styles`](super::MotionSet).
    pub(super) style: Option<usize>,
    pub(super) marks: Marks,
    /// Beats of its songs in seconds from frame 0.
    pub(super) grid_beats_s: Vec<f64>,
}

impl Default for PieceFacts {
    fn default() -> Self {
        Self { weight: 1.0, style: None, marks: Marks::default(), grid_beats_s: Vec::new() }
    }
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
        let speed = joint_speed(decoded.view());
        let columns = match frame {
            MotionFrame::Dancer => to_dancer_frame(motion.positions())?,
            MotionFrame::World => decoded,
        };
        Ok(Self {
            motion: columns,
            songs: Vec::new(),
            speed,
            contacts: contacts(motion.positions()),
            facts: PieceFacts::default(),
        })
    }

    /// Adds a song.
    #[must_use]
    pub fn with_song(mut self, song: SongRows) -> Self {
        self.songs.push(song);
        self
    }

    /// Adds what the data say about it.
    pub(super) fn with_facts(self, facts: PieceFacts) -> Self {
        Self { facts, ..self }
    }

    /// Returns what the data say about it.
    pub(super) fn facts(&self) -> &PieceFacts {
        &self.facts
    }

    /// Returns the mean speed of the joints over some frames, metres a second.
    pub(super) fn speed(&self, frames: Range<usize>) -> f64 {
        let speed = self.speeds(frames);
        FPS as f64 * speed.iter().sum::<f64>() / speed.len().max(1) as f64
    }

    /// Returns the share of some frames in which the dancer hardly moves.
    pub(super) fn slow_share(&self, frames: Range<usize>) -> f64 {
        slow_share(self.speeds(frames), FPS as f64)
    }

    /// Returns the speeds of some frames, of which the motion's last has none.
    fn speeds(&self, frames: Range<usize>) -> &[f64] {
        let end = frames.end.min(self.speed.len());
        &self.speed[frames.start.min(end)..end]
    }

    /// Returns whether the left and the right foot stand from a frame to the next.
    pub(super) fn stands(&self, frame: usize) -> [bool; 2] {
        self.contacts.get(frame).copied().unwrap_or_default()
    }

    /// Returns the frames between the last slow frame of the first five seconds and the first slow
    /// frame of the last five.
    pub(super) fn dancing(&self) -> Range<usize> {
        let slow = |frame: usize| self.slow_share(frame..frame + 1) > 0.0;
        let steps = self.speed.len();
        let begins = (0..steps.min(EDGE)).rev().find(|&frame| slow(frame));
        let begins = begins.map_or(0, |last| last + 1);
        let ends = (steps.saturating_sub(EDGE)..steps).find(|&frame| slow(frame));
        let ends = ends.unwrap_or_else(|| self.frames());
        begins..ends.max(begins)
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
