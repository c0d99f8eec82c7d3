//! The way of decoded audio: trimmed, cut to the wanted range, and on to the resamplers.

use std::ops::Range;

use crate::{
    error::AudioError,
    gapless::Trim,
    limits::{DecodeRequest, SLACK_S},
    outputs::Outputs,
};

/// A decoded song: mono PCM, one signal per wanted rate.
#[derive(Clone, Debug)]
pub struct DecodedAudio {
    /// One mono signal per wanted rate, in the order of the request.
    pub signals: Vec<Vec<f32>>,
    /// Seconds of audio that the signals stand for (after the range was applied).
    pub duration_s: f64,
    /// Sample rate of the upload in Hz.
    pub sample_rate: u32,
    /// Channels of the upload.
    pub channels: usize,
    /// Everything that was trimmed, lost or assumed, in plain words.
    pub warnings: Vec<String>,
}

/// Takes decoded audio of one format.
pub(crate) struct Sink<'a> {
    request: &'a DecodeRequest<'a>,
    trim: Trim,
    pub(crate) rate: u32,
    channels: usize,
    /// Decoded frames, with the encoder's lead-in and padding.
    received: u64,
    window: Window,
    outputs: Outputs,
    /// Loudest sample that was used.
    peak: f32,
}

/// The wanted part in frames of the upload.
#[derive(Clone, Copy, Debug)]
struct Window {
    first: u64,
    end: Option<u64>,
    /// Audible frames so far, used or not.
    position: u64,
}

impl Window {
    /// Returns the wanted part of the next `length` frames.
    fn advance(&mut self, length: usize) -> Range<usize> {
        let within = |frame: u64| {
            usize::try_from(frame.saturating_sub(self.position))
                .map_or(length, |frames| frames.min(length))
        };
        let (first, end) = (within(self.first), self.end.map_or(length, within));
        self.position += length as u64;
        first.min(end)..end
    }

    /// Returns the position, at most the end of the part.
    fn counted(&self) -> u64 {
        self.end.map_or(self.position, |end| end.min(self.position))
    }
}

impl<'a> Sink<'a> {
    /// Plans for audio of `rate` Hz.
    pub(crate) fn new(
        mut trim: Trim,
        rate: u32,
        channels: usize,
        request: &'a DecodeRequest<'a>,
    ) -> Result<Self, AudioError> {
        let frames = |seconds: f64| (seconds * f64::from(rate)).round() as u64;
        let window = Window {
            first: frames(request.range.offset_s),
            end: request.range.duration_s.map(|_| frames(request.range.end_s())),
            position: 0,
        };
        let silence = std::mem::take(&mut trim.silence);
        let mut sink = Self {
            request,
            trim,
            rate,
            channels,
            received: 0,
            window,
            outputs: Outputs::new(rate, request.rates).map_err(AudioError::NoThread)?,
            peak: 0.0,
        };
        sink.start_late(silence)?;
        Ok(sink)
    }

    /// Puts silence in front of the sound, after which its lead-in is cut.
    fn start_late(&mut self, mut frames: u64) -> Result<(), AudioError> {
        const PIECE: [f32; 1024] = [0.0; 1024];
        self.request.limits.check_length(frames as f64 / f64::from(self.rate))?;
        while frames > 0 && !self.is_done() {
            self.request.deadline.check()?;
            let piece = &PIECE[..frames.min(PIECE.len() as u64) as usize];
            self.outputs.push(&piece[self.window.advance(piece.len())]);
            frames -= piece.len() as u64;
        }
        self.check_length()
    }

    /// Returns whether the end of the wanted part has been reached.
    pub(crate) fn is_done(&self) -> bool {
        self.window.end.is_some_and(|end| self.window.position >= end)
    }

    /// Returns the seconds received, with the encoder's lead-in and padding.
    pub(crate) fn received_s(&self) -> f64 {
        self.received as f64 / f64::from(self.rate)
    }

    /// Takes the next frames.
    pub(crate) fn push(&mut self, mono: &[f32]) -> Result<(), AudioError> {
        self.received += mono.len() as u64;
        self.request.limits.check_length(self.received_s() - SLACK_S)?;
        let (window, outputs, peak) = (&mut self.window, &mut self.outputs, &mut self.peak);
        self.trim.pass(mono, |audible| {
            let used = &audible[window.advance(audible.len())];
            *peak = used.iter().fold(*peak, |peak, sample| peak.max(sample.abs()));
            outputs.push(used);
        });
        self.check_length()
    }

    /// Takes `seconds` of silence, in bounded pieces.
    pub(crate) fn push_silence(&mut self, seconds: f64) -> Result<(), AudioError> {
        const PIECE: [f32; 1024] = [0.0; 1024];
        self.request.limits.check_length(seconds)?;
        let mut frames = (seconds * f64::from(self.rate)).round() as usize;
        while frames > 0 && !self.is_done() {
            self.request.deadline.check()?;
            let piece = frames.min(PIECE.len());
            self.push(&PIECE[..piece])?;
            frames -= piece;
        }
        Ok(())
    }

    /// Takes what the trim held back, which is audible after all or padding.
    pub(crate) fn end(&mut self) -> Result<(), AudioError> {
        let (window, outputs) = (&mut self.window, &mut self.outputs);
        self.trim.finish(|audible| outputs.push(&audible[window.advance(audible.len())]));
        self.check_length()
    }

    /// Checks the exact limit, from the start of the file: what is skipped is decoded as well.
    fn check_length(&self) -> Result<(), AudioError> {
        let seconds = self.window.counted() as f64 / f64::from(self.rate);
        self.request.limits.check_length(seconds)
    }

    /// Returns whether nothing was heard: one step of 16 bits is the loudest (-90 dB).
    pub(crate) fn is_silent(&self) -> bool {
        const STEP: f32 = 1.0 / 32_768.0;
        self.peak <= STEP
    }

    /// Returns a warning about the trim.
    pub(crate) fn note(&self) -> Option<String> {
        self.trim.note().map(str::to_owned)
    }

    /// Returns the resampled signals.
    pub(crate) fn finish(self, warnings: Vec<String>) -> Result<DecodedAudio, AudioError> {
        let rate = f64::from(self.rate);
        let used = self.window.counted().saturating_sub(self.window.first);
        let duration_s = used as f64 / rate;
        if used == 0 && self.request.range.offset_s > 0.0 {
            return Err(AudioError::RangeOutside {
                offset_s: self.request.range.offset_s,
                length_s: self.window.position as f64 / rate,
            });
        }
        if duration_s < self.request.limits.min_seconds {
            return Err(self.too_short(duration_s));
        }
        Ok(DecodedAudio {
            signals: self.outputs.finish(),
            duration_s,
            sample_rate: self.rate,
            channels: self.channels,
            warnings,
        })
    }

    /// The song is to blame only where no option leaves so few `seconds` of it.
    fn too_short(&self, seconds: f64) -> AudioError {
        let (range, min_seconds) = (self.request.range, self.request.limits.min_seconds);
        let reason = match range.duration_s {
            Some(asked) if self.is_done() => format!("`duration_s` asks for {asked} s"),
            _ if range.offset_s > 0.0 => format!(
                "the audio is {:.3} s long, and `offset_s`, {}, leaves {seconds:.3} s of it",
                self.window.position as f64 / f64::from(self.rate),
                range.offset_s
            ),
            _ => return AudioError::TooShort { seconds, min_seconds },
        };
        AudioError::PartTooShort { reason, min_seconds }
    }
}

#[cfg(test)]
mod tests {
    use bailando_core::CancelToken;

    use super::*;
    use crate::limits::{AudioLimits, AudioRange, Deadline};

    #[test]
    fn silence_is_given_up_when_the_caller_is_gone() {
        let limits = AudioLimits::default();
        let cancel = CancelToken::new();
        let deadline = Deadline::start(limits.max_decode_time, &cancel);
        let request = DecodeRequest {
            range: AudioRange::default(),
            rates: &[3_840],
            limits: &limits,
            deadline: &deadline,
        };
        let mut sink = Sink::new(Trim::default(), 8_000, 1, &request).unwrap();
        assert!(sink.push_silence(2.0).is_ok());
        assert_eq!(sink.received, 16_000);
        cancel.cancel();
        assert!(matches!(sink.push_silence(60.0), Err(AudioError::Cancelled)));
        assert_eq!(sink.received, 16_000);
    }
}
