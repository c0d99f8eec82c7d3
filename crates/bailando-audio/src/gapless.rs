//! Takes the encoder's lead-in and padding off a decoded stream (FEATURES section 1: otherwise it
//! would be about 25 ms late).
//!
//! Ogg and WebM: packets say how much the decoder takes off. MP3: delay and padding of the LAME
//! tag; the padding is taken off only when the stream is as long as its header says, so that files
//! joined from several or cut short lose nothing. M4A: the edit list or iTunes' tag; it may
//! also let the sound start late. WAV, AIFF and FLAC have none.

use symphonia::core::codecs::audio::well_known::{CODEC_ID_AAC, CODEC_ID_MP3, CODEC_ID_OPUS};

use crate::{container::Container, mp4, packets::TrackInfo, upload::Upload};

/// Streaming cut of the ends of a mono signal.
#[derive(Debug, Default)]
pub(crate) struct Trim {
    /// Frames of silence in front.
    pub(crate) silence: u64,
    /// Frames still to be dropped in front.
    skip: u64,
    /// Frames still to be let through, if that is known from the start.
    keep: Option<u64>,
    /// Frames of padding: the last ones are held back until the end.
    padding: usize,
    /// Length of the whole stream with which the last frames are padding.
    padded_length: Option<u64>,
    held: Vec<f32>,
    received: u64,
    /// A warning about the cut.
    note: Option<String>,
}

impl Trim {
    /// Plans the cut for a stream whose decoder delivers `rate` frames a second.
    pub(crate) fn plan(upload: &Upload, track: &TrackInfo, rate: u32) -> Self {
        match upload.container {
            Container::Mp3 => Self::of_mp3(track, "MP3"),
            Container::M4a => Self::of_m4a(upload, track, rate),
            Container::Webm if [CODEC_ID_AAC, CODEC_ID_MP3].contains(&track.parameters.codec) => {
                Self::of_mp3(track, "Matroska")
            }
            _ => Self::default(),
        }
    }

    /// A stream that does not state where its sound starts.
    fn unknown(name: &str) -> Self {
        let note = format!(
            "the {name} file does not state its encoder delay: the music may start up to 50 ms late"
        );
        Self { note: Some(note), ..Self::default() }
    }

    fn of_mp3(track: &TrackInfo, name: &str) -> Self {
        let Some(delay) = track.delay else {
            return Self::unknown(name);
        };
        let padding = track.padding.unwrap_or(0);
        let ends = u64::from(delay) + u64::from(padding);
        Self {
            skip: u64::from(delay),
            padding: padding as usize,
            padded_length: track.frames.map(|frames| frames.saturating_add(ends)),
            ..Self::default()
        }
    }

    fn of_m4a(upload: &Upload, track: &TrackInfo, rate: u32) -> Self {
        /// Edit lists count in ticks of the movie, usually milliseconds: an end this close to the
        /// media's own end is meant to be that end.
        const ROUNDING_S: f64 = 1.5e-3;
        let declared = track.parameters.sample_rate.unwrap_or(rate);
        let Some(audible) = mp4::audible(&upload.bytes, track.id, declared) else {
            let lossless = ![CODEC_ID_AAC, CODEC_ID_OPUS].contains(&track.parameters.codec);
            return if lossless { Self::default() } else { Self::unknown("M4A") };
        };
        let frames = |seconds: f64| (seconds * f64::from(rate)).round() as u64;
        let media_s = track.frames.map(|frames| frames as f64 / f64::from(declared.max(1)));
        let length_s = match (audible.length_s, media_s) {
            (Some(length), Some(media)) => {
                let to_the_end = media - audible.start_s;
                let same = (length - to_the_end).abs() < ROUNDING_S;
                Some(if same { to_the_end } else { length })
            }
            (length, _) => length,
        };
        Self {
            silence: frames(audible.silence_s),
            skip: frames(audible.start_s),
            keep: length_s.map(frames),
            ..Self::default()
        }
    }

    /// Returns a warning about the cut.
    pub(crate) fn note(&self) -> Option<&str> {
        self.note.as_deref()
    }

    /// Passes the audible part of `signal` on to `sink`, in one or two pieces.
    pub(crate) fn pass(&mut self, signal: &[f32], mut sink: impl FnMut(&[f32])) {
        self.received += signal.len() as u64;
        let skipped =
            usize::try_from(self.skip).map_or(signal.len(), |skip| skip.min(signal.len()));
        self.skip -= skipped as u64;
        let mut rest = &signal[skipped..];
        if let Some(keep) = &mut self.keep {
            let kept = usize::try_from(*keep).map_or(rest.len(), |keep| keep.min(rest.len()));
            *keep -= kept as u64;
            rest = &rest[..kept];
        }
        if self.padding == 0 {
            sink(rest);
            return;
        }
        // Only the last `padding` frames of the held and the new ones together may be padding.
        let certain = (self.held.len() + rest.len()).saturating_sub(self.padding);
        let old = certain.min(self.held.len());
        sink(&self.held[..old]);
        self.held.drain(..old);
        sink(&rest[..certain - old]);
        self.held.extend_from_slice(&rest[certain - old..]);
    }

    /// Passes on the frames held back, unless they are padding.
    pub(crate) fn finish(&mut self, sink: impl FnOnce(&[f32])) {
        let is_padding = self.padded_length.is_none_or(|length| length == self.received);
        if !is_padding {
            sink(&self.held);
        }
        self.held.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(mut trim: Trim, pieces: &[std::ops::Range<u16>]) -> Vec<f32> {
        let mut audible = Vec::new();
        for piece in pieces {
            let signal: Vec<f32> = piece.clone().map(f32::from).collect();
            trim.pass(&signal, |part| audible.extend_from_slice(part));
        }
        trim.finish(|part| audible.extend_from_slice(part));
        audible
    }

    fn counting(range: std::ops::Range<u16>) -> Vec<f32> {
        range.map(f32::from).collect()
    }

    #[test]
    fn padding_goes_only_when_the_length_is_the_declared_one() {
        let trim =
            |length| Trim { skip: 15, padding: 7, padded_length: Some(length), ..Trim::default() };
        let pieces = [0..10, 10..12, 12..40, 40..43];
        assert_eq!(run(trim(43), &pieces), counting(15..36));
        assert_eq!(run(trim(60), &pieces), counting(15..43), "cut short");
        assert_eq!(run(trim(20), &pieces), counting(15..43), "joined files");
    }

    #[test]
    fn a_known_length_is_kept_exactly() {
        let trim = Trim { skip: 3, keep: Some(20), ..Trim::default() };
        assert_eq!(run(trim, &[0..2, 2..10, 10..90]), counting(3..23));
    }
}
