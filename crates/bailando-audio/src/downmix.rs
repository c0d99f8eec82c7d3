//! Decoded packets to mono: the mean of the channels (FEATURES section 1), or one channel where
//! they cancel each other.

use symphonia::core::audio::{
    Audio, AudioBuffer, GenericAudioBufferRef, conv::IntoSample, sample::Sample,
};

/// Loudest sample accepted, relative to full scale; decoders of floating-point formats can put out
/// anything when a file is damaged.
const LOUDEST: f32 = 1000.0;

/// Mixes packets to mono into a buffer of its own.
#[derive(Debug, Default)]
pub(crate) struct Downmix {
    mono: Vec<f32>,
    /// Frames replaced by silence because a sample was not a number or far beyond full scale.
    pub(crate) impossible: usize,
    /// The only channel to use; absent: the mean of all.
    only: Option<usize>,
    /// Energy of every channel, and of the mix.
    channels: Vec<f64>,
    mix: f64,
}

impl Downmix {
    /// Uses one channel, where a frame has it.
    pub(crate) fn of_channel(channel: usize) -> Self {
        Self { only: Some(channel), ..Self::default() }
    }

    /// Returns the loudest channel where the mix lies 30 dB below it: in a song of many channels
    /// the mean alone costs up to 18 dB, the rest is that they cancel each other.
    pub(crate) fn cancelled(&self) -> Option<usize> {
        const RATIO: f64 = 1e-3;
        let loudest = self.channels.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let (channel, energy) = loudest.filter(|_| self.channels.len() > 1)?;
        (self.only.is_none() && *energy > 0.0 && self.mix < RATIO * energy).then_some(channel)
    }

    /// Returns a warning where one channel is used.
    pub(crate) fn note(&self) -> Option<String> {
        let channel = self.only? + 1;
        Some(format!(
            "the channels cancel each other when they are mixed: channel {channel} alone is used"
        ))
    }

    /// Returns the mono signal of `packet`: integers are scaled by their full scale (16 bit:
    /// 1/32768).
    pub(crate) fn mix(&mut self, packet: &GenericAudioBufferRef<'_>) -> &[f32] {
        use GenericAudioBufferRef as Buffer;
        match packet {
            Buffer::U8(buffer) => self.mean(buffer),
            Buffer::U16(buffer) => self.mean(buffer),
            Buffer::U24(buffer) => self.mean(buffer),
            Buffer::U32(buffer) => self.mean(buffer),
            Buffer::S8(buffer) => self.mean(buffer),
            Buffer::S16(buffer) => self.mean(buffer),
            Buffer::S24(buffer) => self.mean(buffer),
            Buffer::S32(buffer) => self.mean(buffer),
            Buffer::F32(buffer) => self.mean(buffer),
            Buffer::F64(buffer) => self.mean(buffer),
        }
    }

    fn mean<S: Sample + IntoSample<f32>>(&mut self, buffer: &AudioBuffer<S>) -> &[f32] {
        let count = buffer.num_planes();
        self.mono.clear();
        self.mono.resize(buffer.frames(), 0.0);
        if self.channels.len() < count {
            self.channels.resize(count, 0.0);
        }
        let only = self.only.filter(|&only| only < count);
        for (channel, plane) in buffer.iter_planes().enumerate() {
            let mut energy = 0.0;
            let used = only.is_none_or(|only| only == channel);
            for (sum, &sample) in self.mono.iter_mut().zip(plane) {
                let sample: f32 = sample.into_sample();
                energy += sample * sample;
                *sum += if used { sample } else { 0.0 };
            }
            if energy.is_finite() {
                self.channels[channel] += f64::from(energy);
            }
        }
        let share = if only.is_some() { 1.0 } else { 1.0 / count.max(1) as f32 };
        let mut energy = 0.0;
        for sample in &mut self.mono {
            *sample *= share;
            if sample.is_nan() || sample.abs() > LOUDEST {
                *sample = 0.0;
                self.impossible += 1;
            }
            energy += *sample * *sample;
        }
        self.mix += f64::from(energy);
        &self.mono
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use symphonia::core::audio::{AudioSpec, layouts};

    fn stereo(frames: &[[f32; 2]]) -> AudioBuffer<f32> {
        let spec = AudioSpec::new(8_000, layouts::CHANNEL_LAYOUT_STEREO);
        let mut buffer = AudioBuffer::new(spec, frames.len());
        for frame in frames {
            buffer.render(Some(1), frame);
        }
        buffer
    }

    #[test]
    fn mean_of_the_channels_and_silence_for_the_impossible() {
        let frames = [[0.5, -0.25], [1.0, 1.0], [f32::NAN, 0.0], [f32::INFINITY, 0.0], [1e9, 0.0]];
        let mut downmix = Downmix::default();
        assert_eq!(downmix.mean(&stereo(&frames)), [0.125, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(downmix.impossible, 3);
    }

    #[test]
    fn channels_that_cancel_are_found() {
        let mut downmix = Downmix::default();
        downmix.mean(&stereo(&[[0.5, -0.5], [0.25, -0.25]]));
        assert_eq!(downmix.cancelled(), Some(1));
        downmix.mean(&stereo(&[[0.5, 0.0]]));
        assert_eq!(downmix.cancelled(), None, "one channel is no cancellation");
        let mut one = Downmix::of_channel(0);
        assert_eq!(one.mean(&stereo(&[[0.5, -0.5]])), [0.5]);
        assert_eq!(one.cancelled(), None);
    }
}
