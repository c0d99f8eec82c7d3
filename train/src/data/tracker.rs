//! The beat network as the tracker of songs' beats.

use std::path::Path;

use bailando::{
    CancelToken,
    features::{BeatFinder, FeatureError, SongBeats},
    model::{BeatNetwork, ModelError},
};

use super::{DataError, audio::decoded, files};

/// The beat network, loaded with its first song.
#[derive(Default)]
pub(super) struct BeatTracker {
    loaded: Option<(BeatFinder, BeatNetwork)>,
}

/// What the network's tracker fails with.
struct Failed(String);

impl From<FeatureError> for Failed {
    fn from(error: FeatureError) -> Self {
        Self(error.to_string())
    }
}

impl From<ModelError> for Failed {
    fn from(error: ModelError) -> Self {
        Self(error.to_string())
    }
}

impl BeatTracker {
    /// Finds the beats of a song.
    pub(super) fn beats(&mut self, path: &Path) -> Result<SongBeats, DataError> {
        let audio = decoded(path, files::read(path)?, &[BeatFinder::HZ])?;
        let signal = audio.signals.first().map_or(&[][..], Vec::as_slice);
        let beats = self.of_signal(signal);
        beats.map_err(|Failed(problem)| DataError::Beats { path: path.to_owned(), problem })
    }

    fn of_signal(&mut self, signal: &[f32]) -> Result<SongBeats, Failed> {
        let (finder, network) = match &mut self.loaded {
            Some(loaded) => loaded,
            none => none.insert((BeatFinder::new(), BeatNetwork::open()?)),
        };
        network.beats(finder, signal, &CancelToken::new())
    }
}
