//! The packet loop: decode, mix to mono, cut, resample, count; nothing of a song is kept but the
//! resampled outputs.

use symphonia::core::errors::Error as SymphoniaError;

use super::{
    AudioError, AudioLimits, AudioRange, DecodedAudio,
    downmix::Downmix,
    gapless::Trim,
    limits::{SLACK_S, Watch},
    outputs::Outputs,
    sniff::{Container, Upload},
    source::{Packets, ogg_is_whole},
};

/// What one call of the decoder is to do.
#[derive(Clone, Copy, Debug)]
pub(super) struct Job<'job> {
    pub(super) range: AudioRange,
    pub(super) rates: &'job [u32],
    pub(super) limits: &'job AudioLimits,
    pub(super) watch: &'job Watch<'job>,
}

/// What happened to the packets of a file.
#[derive(Debug, Default)]
struct Tally {
    good: usize,
    damaged: usize,
    last_fault: Option<String>,
    /// Seconds of packets that were lost before the first good one.
    lost_in_front_s: f64,
    chained: bool,
}

/// Decodes all packets of `upload` that the range needs.
pub(super) fn decode_packets(
    mut packets: Packets,
    upload: &Upload,
    job: &Job<'_>,
) -> Result<DecodedAudio, AudioError> {
    let mut decoder = packets.decoder()?;
    let mut downmix = Downmix::default();
    let mut tally = Tally::default();
    let mut sink: Option<Sink<'_>> = None;
    while let Some(packet) = packets.next(job.watch)? {
        let missing_s = packets.seconds_lost_before(&packet);
        if missing_s > 0.0 {
            tally.lose(missing_s, "packets are missing", sink.as_mut())?;
        }
        match decoder.decode(&packet) {
            Ok(buffer) => {
                tally.good += 1;
                let (rate, channels) = (buffer.spec().rate(), buffer.spec().channels().count());
                if buffer.frames() == 0 {
                    continue;
                }
                job.limits.check_format(rate, channels)?;
                let sink = match &mut sink {
                    Some(sink) => sink,
                    none => {
                        let trim = Trim::plan(upload, &packets.track, rate);
                        let mut new = Sink::new(trim, rate, channels, job);
                        new.silence(tally.lost_in_front_s)?;
                        none.insert(new)
                    }
                };
                sink.check_same_rate(rate, upload)?;
                sink.take(downmix.mix(&buffer))?;
            }
            Err(SymphoniaError::ResetRequired) => {
                tally.chained = true;
                break;
            }
            Err(error) => {
                let seconds = packets.track.seconds(&packet);
                tally.lose(seconds, &error.to_string(), sink.as_mut())?;
            }
        }
        if sink.as_ref().is_some_and(Sink::is_done) {
            break;
        }
    }
    let ogg_cut = upload.container == Container::Ogg && !ogg_is_whole(&upload.bytes);
    packets.ending.cut_off |= ogg_cut;
    finish(sink, &packets, &tally, &downmix, job)
}

impl Tally {
    /// Counts a lost packet. Silence in its place keeps the beats behind it where they are.
    fn lose(
        &mut self,
        seconds: f64,
        fault: &str,
        sink: Option<&mut Sink<'_>>,
    ) -> Result<(), AudioError> {
        self.damaged += 1;
        self.last_fault = Some(fault.to_owned());
        match sink {
            Some(sink) => sink.silence(seconds),
            None => {
                self.lost_in_front_s += seconds;
                Ok(())
            }
        }
    }
}

/// Judges what was decoded and puts the result together.
fn finish(
    sink: Option<Sink<'_>>,
    packets: &Packets,
    tally: &Tally,
    downmix: &Downmix,
    job: &Job<'_>,
) -> Result<DecodedAudio, AudioError> {
    let damaged = tally.damaged + packets.ending.faults;
    if damaged > tally.good {
        let fault = tally.last_fault.as_deref().unwrap_or("malformed stream");
        return Err(AudioError::Malformed {
            container: packets.container,
            reason: format!(
                "{damaged} of {} packets could not be decoded (the last: {fault})",
                damaged + tally.good
            ),
        });
    }
    let Some(mut sink) = sink else {
        if packets.ending.cut_off {
            return Err(AudioError::Malformed {
                container: packets.container,
                reason: "it ends before its first audio".to_owned(),
            });
        }
        return Err(AudioError::TooShort {
            seconds: 0.0,
            min_seconds: job.limits.min_seconds,
        });
    };
    sink.end()?;
    let mut warnings: Vec<String> = sink.trim.note().map(str::to_owned).into_iter().collect();
    if tally.damaged > 0 {
        let count = tally.damaged;
        warnings.push(format!(
            "damaged packets were skipped and replaced by silence, in {count} place(s)"
        ));
    }
    if downmix.impossible > 0 {
        let count = downmix.impossible;
        warnings.push(format!(
            "{count} samples with impossible values were replaced by silence"
        ));
    }
    if tally.chained || packets.ending.chained {
        warnings.push("only the first of several streams in the file is used".to_owned());
    }
    if !sink.is_done() {
        warnings.extend(cut_short(packets, &sink));
    }
    sink.result(warnings)
}

/// A warning when a file holds less audio than it says.
fn cut_short(packets: &Packets, sink: &Sink<'_>) -> Option<String> {
    const NOTICEABLE_S: f64 = 0.1;
    let held = sink.received as f64 / f64::from(sink.rate);
    let declared = packets.track.frames.map(|frames| {
        let rate = packets.track.parameters.sample_rate.unwrap_or(sink.rate);
        frames as f64 / f64::from(rate.max(1))
    });
    match declared {
        Some(declared) if declared > held + NOTICEABLE_S => Some(format!(
            "the file is cut short or damaged: it says {declared:.1} s of audio and holds {held:.1} s"
        )),
        // A WAV written to a pipe states no length and simply ends.
        None if packets.container == Container::Wav => None,
        _ if packets.ending.cut_off || packets.ending.faults > 0 => Some(format!(
            "the file is damaged or cut short after {held:.1} s of audio"
        )),
        _ => None,
    }
}

/// Where decoded audio goes: cut, the wanted range, and on to the resamplers.
struct Sink<'job> {
    job: &'job Job<'job>,
    trim: Trim,
    rate: u32,
    channels: usize,
    /// Decoded frames, with the encoder's lead-in and padding.
    received: u64,
    window: Window,
    outputs: Outputs,
}

/// The wanted part in frames of the upload.
#[derive(Clone, Copy, Debug)]
struct Window {
    first: u64,
    end: Option<u64>,
    /// Audible frames seen, used or not.
    position: u64,
}

impl Window {
    /// The part of the next `length` frames that is wanted.
    fn advance(&mut self, length: usize) -> std::ops::Range<usize> {
        let within = |frame: u64| {
            usize::try_from(frame.saturating_sub(self.position))
                .map_or(length, |frames| frames.min(length))
        };
        let (first, end) = (within(self.first), self.end.map_or(length, within));
        self.position += length as u64;
        first.min(end)..end
    }

    /// Wanted frames seen so far.
    fn used(&self) -> u64 {
        let end = self.end.map_or(self.position, |end| end.min(self.position));
        end.saturating_sub(self.first)
    }
}

impl<'job> Sink<'job> {
    /// Plans for the format that the first packet has.
    fn new(trim: Trim, rate: u32, channels: usize, job: &'job Job<'job>) -> Self {
        let frames = |seconds: f64| (seconds * f64::from(rate)).round() as u64;
        let window = Window {
            first: frames(job.range.offset_s),
            end: job.range.duration_s.map(|_| frames(job.range.end_s())),
            position: 0,
        };
        Self {
            job,
            trim,
            rate,
            channels,
            received: 0,
            window,
            outputs: Outputs::new(rate, job.rates),
        }
    }

    fn check_same_rate(&self, rate: u32, upload: &Upload) -> Result<(), AudioError> {
        if rate == self.rate {
            return Ok(());
        }
        Err(AudioError::Malformed {
            container: upload.container,
            reason: format!(
                "its sample rate changes from {} to {rate} Hz midway",
                self.rate
            ),
        })
    }

    /// Whether all that is wanted has been seen.
    fn is_done(&self) -> bool {
        self.window
            .end
            .is_some_and(|end| self.window.position >= end)
    }

    fn take(&mut self, mono: &[f32]) -> Result<(), AudioError> {
        self.received += mono.len() as u64;
        let decoded_s = self.received as f64 / f64::from(self.rate);
        self.job.limits.check_length(decoded_s - SLACK_S)?;
        let (window, outputs) = (&mut self.window, &mut self.outputs);
        self.trim
            .pass(mono, |heard| use_part(window, outputs, heard));
        self.check_used_length()
    }

    /// Takes `seconds` of silence, in bounded pieces.
    fn silence(&mut self, seconds: f64) -> Result<(), AudioError> {
        const PIECE: [f32; 1024] = [0.0; 1024];
        self.job.limits.check_length(seconds)?;
        let mut frames = (seconds * f64::from(self.rate)).round() as usize;
        while frames > 0 && !self.is_done() {
            self.job.watch.check()?;
            let piece = frames.min(PIECE.len());
            self.take(&PIECE[..piece])?;
            frames -= piece;
        }
        Ok(())
    }

    fn end(&mut self) -> Result<(), AudioError> {
        let (window, outputs) = (&mut self.window, &mut self.outputs);
        self.trim.finish(|heard| use_part(window, outputs, heard));
        self.check_used_length()
    }

    /// The limit counts from the file's start, since what is skipped is decoded as well.
    fn check_used_length(&self) -> Result<(), AudioError> {
        let position = self.window.position;
        let counted = self.window.end.map_or(position, |end| end.min(position));
        let seconds = counted as f64 / f64::from(self.rate);
        self.job.limits.check_length(seconds)
    }

    fn result(self, warnings: Vec<String>) -> Result<DecodedAudio, AudioError> {
        let rate = f64::from(self.rate);
        let duration_s = self.window.used() as f64 / rate;
        if duration_s == 0.0 && self.job.range.offset_s > 0.0 {
            return Err(AudioError::RangeOutside {
                offset_s: self.job.range.offset_s,
                length_s: self.window.position as f64 / rate,
            });
        }
        if duration_s < self.job.limits.min_seconds {
            return Err(AudioError::TooShort {
                seconds: duration_s,
                min_seconds: self.job.limits.min_seconds,
            });
        }
        Ok(DecodedAudio {
            signals: self.outputs.finish(),
            duration_s,
            sample_rate: self.rate,
            channels: self.channels,
            warnings,
        })
    }
}

/// Resamples the wanted part of what is heard.
fn use_part(window: &mut Window, outputs: &mut Outputs, heard: &[f32]) {
    outputs.push(&heard[window.advance(heard.len())]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use bailando_core::CancelToken;

    #[test]
    fn silence_is_given_up_when_the_caller_is_gone() {
        let limits = AudioLimits::default();
        let cancel = CancelToken::new();
        let watch = Watch::start(&limits, &cancel);
        let job = Job {
            range: AudioRange::default(),
            rates: &[3_840],
            limits: &limits,
            watch: &watch,
        };
        let mut sink = Sink::new(Trim::default(), 8_000, 1, &job);
        assert!(sink.silence(2.0).is_ok());
        assert_eq!(sink.received, 16_000);
        cancel.cancel();
        assert!(matches!(sink.silence(60.0), Err(AudioError::Cancelled)));
        assert_eq!(sink.received, 16_000);
    }
}
