//! What was found of a song.

use super::spectrogram::FRAMES_PER_SECOND;

/// Seconds by which the beat of a frame lies after the frame's number: its middle.
const LATER_S: f64 = 0.010;
/// Frames on either side of a moment in which a first beat is looked for.
const REACH: usize = 2;

/// Tempo, beats and bars of a song; without beats all is empty or 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SongBeats {
    /// Beats per minute; of a tempo that changes, of the distances near the median.
    pub tempo_bpm: f64,
    /// Whether the tempo of every 16 beats is within 3 % of the whole song's.
    pub tempo_steady: bool,
    /// Seconds of the beats, ascending.
    pub beats_s: Vec<f64>,
    /// Seconds of the first beats of bars: some of `beats_s`.
    pub downbeats_s: Vec<f64>,
    /// Beats of a bar: 3 or 4.
    pub metre: usize,
    /// How much more active the network is on the beats than between them, 0 to 1.
    pub confidence: f64,
    /// Activation of a first beat in each frame.
    pub(crate) downbeats: Vec<f32>,
}

impl SongBeats {
    /// Returns the frames that the beats lie in, at `fps` frames a second.
    #[must_use]
    pub fn frames(&self, fps: f64) -> Vec<usize> {
        self.beats_s.iter().map(|second| (second * fps).round() as usize).collect()
    }

    /// The highest activation of a first beat near `seconds`.
    pub(crate) fn downbeat_near(&self, seconds: f64) -> f64 {
        let frame = ((seconds - LATER_S) * FRAMES_PER_SECOND).round().max(0.0) as usize;
        let near = self.downbeats.iter().skip(frame.saturating_sub(REACH));
        let near = near.take(REACH + 1 + frame.min(REACH));
        near.copied().fold(0.0_f32, f32::max).into()
    }
}

/// The second of the beat in a frame.
pub(super) fn second_of(frame: usize) -> f64 {
    // As one division, so that 0.31 s is 0.31 and nothing near it.
    (2 * frame + 1) as f64 / (2.0 * FRAMES_PER_SECOND)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_beats_are_looked_for_two_frames_around() {
        let mut downbeats = vec![0.0; 60];
        downbeats[25] = 0.5;
        let song = SongBeats { downbeats, ..SongBeats::default() };
        let expected = [(22, 0.0), (23, 0.5), (27, 0.5), (28, 0.0), (0, 0.0), (99, 0.0)];
        for (frame, activation) in expected {
            assert_eq!(song.downbeat_near(second_of(frame)), activation, "{frame}");
        }
        assert_eq!(second_of(15), 0.31);
    }

    #[test]
    fn frames_of_the_motion_are_the_nearest() {
        let song = SongBeats { beats_s: vec![0.01, 0.31], ..SongBeats::default() };
        assert_eq!(song.frames(60.0), [1, 19]);
    }
}
