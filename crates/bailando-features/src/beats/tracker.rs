//! From samples to the beats of a song.

use bailando_core::CancelToken;
use ndarray::{Array2, ArrayView2, Axis, Slice};

use super::{
    bars,
    decode::Decoder,
    hmm::{Activation, Beat},
    octave,
    song::{SongBeats, second_of},
    spectrogram::{ROW, Spectrogram, frame_count, gain},
    tempo::tempo,
};
use crate::{error::FeatureError, extractor::check_samples};

/// Frames that are shown to the network at once: eight seconds.
const CHUNK: usize = 400;
/// Fewer beats are none.
const FEWEST: usize = 4;
/// Confidence below which there are no beats. Music has 0.45 and more, noise at most 0.25, speech
/// 0.3.
const LEAST_CONFIDENCE: f64 = 0.33;
/// Frames on either side of a beat that are neither on it nor between beats.
const NEAR: usize = 2;

/// A finder of beats, bars and metre: [`BeatFinder::new`] plans all tables and transforms.
///
/// A song is one call: its loudness, and the likelihood of its beats, depend on the whole of it.
///
/// ```
/// use bailando_core::CancelToken;
/// use bailando_features::{BeatFinder, FeatureError};
/// use ndarray::Array2;
///
/// // `bailando-model` has the network; here one that is never active.
/// let network = |rows: ndarray::ArrayView2<'_, f32>| -> Result<_, FeatureError> {
///     Ok(Array2::zeros((rows.nrows(), 3)))
/// };
/// let silence = vec![0.0; 4 * BeatFinder::HZ as usize];
/// let song = BeatFinder::new().find(&silence, &CancelToken::new(), network)?;
/// assert!(song.beats_s.is_empty());
/// # Ok::<(), FeatureError>(())
/// ```
#[derive(Debug)]
pub struct BeatFinder {
    spectrogram: Spectrogram,
    decoder: Decoder,
}

impl Default for BeatFinder {
    fn default() -> Self {
        Self::new()
    }
}

impl BeatFinder {
    /// Sample rate of the songs in Hz.
    pub const HZ: u32 = 22_050;
    /// Columns of the rows that the network reads.
    pub const COLUMNS: usize = ROW;

    /// Plans the transforms and the models of bars.
    #[must_use]
    pub fn new() -> Self {
        Self { spectrogram: Spectrogram::new(), decoder: Decoder::new() }
    }

    /// Finds the beats of `pcm` (mono, 22,050 Hz). `network` reads the song's rows `[n, 272]` at 50
    /// a second, at most 400 at a time and in their order, and gives `[n, 3]`: the probability of a
    /// beat, of a bar's first beat, and of neither. Stops before the next 400 rows once `cancel` is
    /// triggered.
    ///
    /// # Errors
    /// [`FeatureError::NotFinite`] and [`FeatureError::OutOfRange`] for samples that are no sound,
    /// [`FeatureError::Activations`], [`FeatureError::Cancelled`], and the network's own.
    pub fn find<E: From<FeatureError>>(
        &mut self,
        pcm: &[f32],
        cancel: &CancelToken,
        network: impl FnMut(ArrayView2<'_, f32>) -> Result<Array2<f32>, E>,
    ) -> Result<SongBeats, E> {
        check_samples(pcm)?;
        let (activations, rises) = self.activations(pcm, cancel, network)?;
        Ok(self.beats(activations, &rises))
    }

    /// The network's activations, and the rise of all bands, in each frame.
    fn activations<E: From<FeatureError>>(
        &mut self,
        pcm: &[f32],
        cancel: &CancelToken,
        mut network: impl FnMut(ArrayView2<'_, f32>) -> Result<Array2<f32>, E>,
    ) -> Result<(Vec<Activation>, Vec<f32>), E> {
        let (frames, gain) = (frame_count(pcm.len()), gain(pcm));
        let (mut activations, mut rises) = (Vec::with_capacity(frames), Vec::with_capacity(frames));
        self.spectrogram.restart();
        for start in (0..frames).step_by(CHUNK) {
            if cancel.is_cancelled() {
                return Err(FeatureError::Cancelled.into());
            }
            let rows = self.spectrogram.rows(pcm, gain, start..(start + CHUNK).min(frames));
            let active = network(rows.view())?;
            let is_probability = |value: &f32| (0.0..=1.0).contains(value);
            if active.dim() != (rows.nrows(), 3) || !active.iter().all(is_probability) {
                let shape = active.dim();
                return Err(FeatureError::Activations { rows: rows.nrows(), shape }.into());
            }
            let columns = active.rows().into_iter();
            activations.extend(columns.map(|row| Activation { beat: row[0], downbeat: row[1] }));
            let rising = rows.slice_axis(Axis(1), Slice::from(ROW / 2..));
            rises.extend(rising.rows().into_iter().map(|row| row.sum()));
        }
        Ok((activations, rises))
    }

    /// The beats after the activations.
    fn beats(&self, activations: Vec<Activation>, rises: &[f32]) -> SongBeats {
        let (mut beats, mut metre) = self.decoder.beats(&activations);
        // Noise would pass as a very fast beat.
        if confidence(&beats, &activations) < LEAST_CONFIDENCE {
            return SongBeats::default();
        }
        let is_new = octave::correct(&mut beats, &activations);
        octave::trim(&mut beats, &activations);
        if is_new || !bars::are_told(&beats, &activations) {
            metre = bars::number_by_accent(&mut beats, rises);
        }
        let beats_s: Vec<f64> = beats.iter().map(|beat| second_of(beat.frame)).collect();
        let Some((tempo_bpm, tempo_steady)) = tempo(&beats_s).filter(|_| beats.len() >= FEWEST)
        else {
            return SongBeats::default();
        };
        let first = beats.iter().filter(|beat| beat.number == 1);
        SongBeats {
            tempo_bpm,
            tempo_steady,
            downbeats_s: first.map(|beat| second_of(beat.frame)).collect(),
            beats_s,
            metre,
            confidence: confidence(&beats, &activations).clamp(0.0, 1.0),
            downbeats: activations.into_iter().map(|activation| activation.downbeat).collect(),
        }
    }
}

/// The mean activation on the beats less that between them; 0 without beats.
fn confidence(beats: &[Beat], activations: &[Activation]) -> f64 {
    let mean = |(sum, count): (f64, usize)| sum / count.max(1) as f64;
    let add =
        |(sum, count), activation: &Activation| (sum + f64::from(activation.any()), count + 1);
    let on = beats.iter().filter_map(|beat| activations.get(beat.frame));
    let between = beats.windows(2).flat_map(|pair| {
        let between = pair[0].frame + NEAR + 1..pair[1].frame.saturating_sub(NEAR);
        activations.get(between).into_iter().flatten()
    });
    mean(on.fold((0.0, 0), add)) - mean(between.fold((0.0, 0), add))
}
