//! The decoder's one pass over a file; of a song only the resampled outputs are kept.

use std::panic::{AssertUnwindSafe, catch_unwind};

use bailando_core::CancelToken;
use bytes::Bytes;
use symphonia::core::{audio::GenericAudioBufferRef, errors::Error as SymphoniaError};

use crate::{
    codec,
    container::Container,
    demux::Demuxer,
    downmix::Downmix,
    error::AudioError,
    flac::Gap,
    gapless::Trim,
    headers,
    limits::{AudioLimits, AudioRange, Deadline, DecodeRequest},
    resample::Resampler,
    sink::{DecodedAudio, Sink},
    sniff::sniff,
    upload::Upload,
};

/// Decodes `bytes`, mixes all channels to one and resamples to each of `rates` (Hz) while decoding.
///
/// The container is detected from the bytes. Outside the used range the signals are zero, as at the
/// ends of a file; encoder delay and padding are taken off; damaged packets become silence. Beyond
/// the outputs (`4 * duration * rate` bytes per rate) nothing grows with the length of the audio:
/// there are at most 4 MiB of packets read ahead, some seconds on the way to the resamplers, and
/// one filter table per rate (usually 0.7 MiB, at most 4 MiB; the last 8 are kept for later calls).
///
/// `max_seconds` counts from the start of the file to the end of the range, because everything
/// before the range is decoded as well. Nothing after the range is decoded or counted.
///
/// # Errors
/// Any [`AudioError`]: unknown container, undecodable, outside `limits` or the range, cancelled. A
/// panic of the decoder is an error of this call alone.
pub fn decode(
    bytes: Bytes,
    range: AudioRange,
    rates: &[u32],
    limits: &AudioLimits,
    cancel: &CancelToken,
) -> Result<DecodedAudio, AudioError> {
    contained(move || {
        let deadline = Deadline::start(limits.max_decode_time, cancel);
        deadline.check()?;
        range.check()?;
        if let Some(&hz) = rates.iter().find(|&&hz| hz == 0) {
            return Err(AudioError::OutputRate { hz });
        }
        let request = DecodeRequest { range, rates, limits, deadline: &deadline };
        let upload = sniff(&bytes)?;
        headers::check(&upload, &request)?;
        let mut pass = Pass::open(&upload, &request)?;
        pass.run()?;
        let Some(channel) = pass.downmix.cancelled() else { return pass.finish() };
        // The channels cancel each other: one of them alone is the song.
        drop(pass);
        let mut pass = Pass::open(&upload, &request)?;
        pass.downmix = Downmix::of_channel(channel);
        pass.run()?;
        pass.finish()
    })
}

/// Turns a panic inside `work` into an error (RELIABILITY, defence 5). Everything that `work`
/// touches is dropped by the unwinding, so nothing half-changed is seen afterwards.
fn contained<T>(work: impl FnOnce() -> Result<T, AudioError>) -> Result<T, AudioError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        let message = payload
            .downcast_ref::<&str>()
            .map(|text| (*text).to_owned())
            .or_else(|| payload.downcast_ref::<String>().cloned())
            .unwrap_or_else(|| "no message".to_owned());
        Err(AudioError::DecoderPanic { message })
    })
}

/// The warning about a song that has nothing to dance to.
const SILENT: &str = "the audio is silent: the dance follows no music";

/// One pass over the packets of a file.
struct Pass<'a> {
    upload: &'a Upload,
    request: &'a DecodeRequest<'a>,
    demuxer: Demuxer,
    downmix: Downmix,
    /// Another sample rate that the stream has come to, and its way to the first one.
    bridge: Option<(u32, Resampler)>,
    /// The sample rates that the stream came to after its first.
    further_rates: Vec<u32>,
    /// Made for the format of the first good packet.
    sink: Option<Sink<'a>>,
    good: usize,
    damaged: usize,
    last_fault: Option<String>,
    /// Seconds that were lost before the first good packet.
    lost_in_front_s: f64,
    /// Seconds of the recording before the file's first packet.
    cut_from_s: Option<f64>,
}

impl<'a> Pass<'a> {
    fn open(upload: &'a Upload, request: &'a DecodeRequest<'a>) -> Result<Self, AudioError> {
        Ok(Self {
            upload,
            request,
            demuxer: Demuxer::open(upload)?,
            downmix: Downmix::default(),
            bridge: None,
            further_rates: Vec::new(),
            sink: None,
            good: 0,
            damaged: 0,
            last_fault: None,
            lost_in_front_s: 0.0,
            cut_from_s: None,
        })
    }

    /// Decodes all packets that the range needs.
    fn run(&mut self) -> Result<(), AudioError> {
        /// Packets that may be damaged before most have to be good: a minute and a half of music.
        const DAMAGED_AT_FIRST: usize = 4_096;
        let mut decoder = self.demuxer.decoder()?;
        while let Some(packet) = self.demuxer.next(self.request)? {
            match self.demuxer.gap_before(&packet) {
                Some(Gap::Lost(seconds)) => self.lose(seconds, "packets are missing")?,
                Some(Gap::CutFrom(seconds)) => self.cut_from_s = Some(seconds),
                None => {}
            }
            match decoder.decode(&packet) {
                Ok(buffer) => {
                    self.good += 1;
                    if buffer.frames() > 0 {
                        self.take(&buffer)?;
                    }
                }
                Err(SymphoniaError::ResetRequired) => {
                    self.demuxer.state.chained = true;
                    break;
                }
                Err(error) => {
                    let seconds = self.demuxer.track.seconds(&packet);
                    self.lose(seconds, &error.to_string())?;
                    if self.damaged > self.good + DAMAGED_AT_FIRST {
                        return Err(self.mostly_damaged(self.damaged));
                    }
                }
            }
            if self.sink.as_ref().is_some_and(Sink::is_done) {
                break;
            }
        }
        self.end_bridge()?;
        self.sink.as_mut().map_or(Ok(()), Sink::end)
    }

    /// Mixes a decoded packet and passes it on.
    fn take(&mut self, buffer: &GenericAudioBufferRef<'_>) -> Result<(), AudioError> {
        let (rate, channels) = (buffer.spec().rate(), buffer.spec().channels());
        self.prepare_sink(rate, channels.count())?;
        let mono = self.downmix.mix(buffer);
        let Some(sink) = &mut self.sink else { return Ok(()) };
        match &mut self.bridge {
            None => sink.push(mono),
            Some((_, resampler)) => {
                let mut resampled = Vec::new();
                resampler.process(mono, &mut resampled);
                sink.push(&resampled)
            }
        }
    }

    /// Makes the sink at the first good packet, and a bridge to it where the rate changes later.
    fn prepare_sink(&mut self, rate: u32, channels: usize) -> Result<(), AudioError> {
        self.request.limits.check_format(rate, channels)?;
        let Some(sink) = &self.sink else {
            let trim = Trim::plan(self.upload, &self.demuxer.track, rate);
            let mut sink = Sink::new(trim, rate, channels, self.request)?;
            sink.push_silence(self.lost_in_front_s)?;
            self.sink = Some(sink);
            return Ok(());
        };
        let first = sink.rate;
        if self.bridge.as_ref().map_or(first, |(rate, _)| *rate) == rate {
            return Ok(());
        }
        self.end_bridge()?;
        if rate != first {
            self.bridge = Some((rate, Resampler::new(rate, first)));
            if !self.further_rates.contains(&rate) {
                self.further_rates.push(rate);
            }
        }
        Ok(())
    }

    /// Passes on what a bridge still holds.
    fn end_bridge(&mut self) -> Result<(), AudioError> {
        let (Some((_, resampler)), Some(sink)) = (self.bridge.take(), &mut self.sink) else {
            return Ok(());
        };
        let mut rest = Vec::new();
        resampler.finish(&mut rest);
        sink.push(&rest)
    }

    /// Counts lost audio. Silence in its place keeps the beats after it where they are.
    fn lose(&mut self, seconds: f64, fault: &str) -> Result<(), AudioError> {
        self.damaged += 1;
        self.last_fault = Some(fault.to_owned());
        match &mut self.sink {
            Some(sink) => sink.push_silence(seconds),
            None => {
                self.lost_in_front_s += seconds;
                Ok(())
            }
        }
    }

    /// Judges what was decoded, and puts the result together.
    fn finish(mut self) -> Result<DecodedAudio, AudioError> {
        let container = self.upload.container;
        let damaged = self.damaged + self.demuxer.state.faults;
        if damaged > self.good {
            return Err(self.mostly_damaged(damaged));
        }
        let Some(sink) = self.sink.take() else {
            if self.demuxer.state.cut_off {
                return Err(AudioError::Malformed {
                    container,
                    reason: "it ends before its first audio".to_owned(),
                });
            }
            return Err(AudioError::TooShort {
                seconds: 0.0,
                min_seconds: self.request.limits.min_seconds,
            });
        };
        let warnings = self.warnings(&sink);
        sink.finish(warnings)
    }

    fn mostly_damaged(&self, damaged: usize) -> AudioError {
        let fault = self.last_fault.as_deref().unwrap_or("malformed stream");
        AudioError::Malformed {
            container: self.upload.container,
            reason: format!(
                "{damaged} of {} packets could not be decoded (the last: {fault})",
                damaged + self.good
            ),
        }
    }

    fn warnings(&self, sink: &Sink<'_>) -> Vec<String> {
        let lost = (self.damaged > 0).then(|| {
            format!(
                "damaged packets were skipped and replaced by silence, in {} place(s)",
                self.damaged
            )
        });
        let cut = self.cut_from_s.map(|seconds| {
            format!("the file is cut from a longer recording: {seconds:.1} s before it are missing")
        });
        let impossible = (self.downmix.impossible > 0).then(|| {
            format!(
                "{} samples with impossible values were replaced by silence",
                self.downmix.impossible
            )
        });
        let chained = self
            .demuxer
            .state
            .chained
            .then(|| "only the first of several streams in the file is used".to_owned());
        let short = if sink.is_done() { None } else { self.cut_short(sink) };
        let rates = (!self.further_rates.is_empty()).then(|| {
            format!(
                "the sample rate changes from {} to {:?} Hz within the file: all is resampled",
                sink.rate, self.further_rates
            )
        });
        let core = codec::note(&self.demuxer.track.parameters);
        let notes = [sink.note(), lost, cut, impossible, chained, short, rates, core];
        let heard = [self.downmix.note(), sink.is_silent().then(|| SILENT.to_owned())];
        let assumed = self.upload.assumed.iter().cloned();
        assumed.chain(notes.into_iter().chain(heard).flatten()).collect()
    }

    /// Returns a warning when the file holds less audio than it declares.
    fn cut_short(&self, sink: &Sink<'_>) -> Option<String> {
        const NOTICEABLE_S: f64 = 0.1;
        let held = sink.received_s();
        let track = &self.demuxer.track;
        let declared = track.frames.map(|frames| {
            let rate = track.parameters.sample_rate.unwrap_or(sink.rate);
            frames as f64 / f64::from(rate.max(1)) - self.cut_from_s.unwrap_or_default()
        });
        match declared {
            Some(declared) if declared > held + NOTICEABLE_S => Some(format!(
                "the file is cut short or damaged: it says {declared:.1} s of audio and holds \
                 {held:.1} s"
            )),
            // A WAV written to a pipe declares no length and simply ends.
            None if self.upload.container == Container::Wav => None,
            _ if self.demuxer.state.cut_off || self.demuxer.state.faults > 0 => {
                Some(format!("the file is damaged or cut short after {held:.1} s of audio"))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_of_this_call_alone() {
        let broken: Result<(), _> = contained(|| panic!("index {} out of bounds", 3));
        assert!(matches!(
            broken,
            Err(AudioError::DecoderPanic { message }) if message == "index 3 out of bounds"
        ));
        assert!(matches!(contained(|| Ok(7)), Ok(7)));
    }
}
