//! Decoding songs on all cores: length, sound, beats.

use std::{
    collections::HashMap,
    num::NonZero,
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use bailando::features::{FeatureExtractor, Profile, Rate};

use crate::{
    data::{DataError, audio::decoded, files},
    sha256,
};

/// What is known of a song.
#[derive(Clone, Debug)]
pub(super) struct SongFacts {
    /// SHA-256 of the file.
    pub(super) hash: String,
    pub(super) seconds: f64,
    /// Root mean square of the samples, full scale 1.
    pub(super) level: f64,
    /// Tracked beats in seconds, where they were asked for.
    pub(super) beats: Option<Vec<f64>>,
}

/// Facts of each song, or why there are none.
pub(super) type Songs = HashMap<PathBuf, Result<SongFacts, String>>;

/// Decodes the songs; beats of those marked.
pub(super) fn track(songs: &[(&Path, bool)]) -> Songs {
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Songs::new());
    let workers = thread::available_parallelism().map_or(1, NonZero::get);
    thread::scope(|scope| {
        for _ in 0..workers.min(songs.len()) {
            scope.spawn(|| {
                let mut extractor = FeatureExtractor::new(Rate::Beats, Profile::Librosa011);
                while let Some(&(path, beats)) = songs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let facts = facts(path, beats.then_some(&mut extractor));
                    let facts = facts.map_err(|error| error.to_string());
                    let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                    done.insert(path.to_owned(), facts);
                }
            });
        }
    });
    done.into_inner().unwrap_or_else(PoisonError::into_inner)
}

fn facts(path: &Path, extractor: Option<&mut FeatureExtractor>) -> Result<SongFacts, DataError> {
    let bytes = files::read(path)?;
    let hash = sha256(&bytes);
    // The low rate is enough for length and level, and eight times less work.
    let rate = if extractor.is_some() { Rate::Beats } else { Rate::Conditioning };
    let decoded = decoded(path, bytes, &[rate.hz()])?;
    let signal = decoded.signals.first().map_or(&[][..], Vec::as_slice);
    let power: f64 = signal.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
    let beats = match extractor {
        None => None,
        Some(extractor) => {
            let beats = extractor
                .beats(signal)
                .map_err(|source| DataError::Features { path: path.to_owned(), source })?;
            let rows_per_second = rate.rows_per_second();
            let seconds = beats.frames.iter().map(|&row| row as f64 / rows_per_second);
            Some(seconds.collect())
        }
    };
    Ok(SongFacts {
        hash,
        seconds: decoded.duration_s,
        level: (power / signal.len().max(1) as f64).sqrt(),
        beats,
    })
}
