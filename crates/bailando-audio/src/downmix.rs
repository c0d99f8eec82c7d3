//! Decoded packets to mono: the mean of the channels (FEATURES section 1).

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
}

impl Downmix {
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
        let mut planes = buffer.iter_planes();
        self.mono.clear();
        if let Some(first) = planes.next() {
            self.mono.extend(first.iter().map(|&sample| sample.into_sample()));
        }
        for plane in planes {
            for (sum, &sample) in self.mono.iter_mut().zip(plane) {
                *sum += sample.into_sample();
            }
        }
        let share = 1.0 / buffer.num_planes().max(1) as f32;
        for sample in &mut self.mono {
            *sample *= share;
            if sample.is_nan() || sample.abs() > LOUDEST {
                *sample = 0.0;
                self.impossible += 1;
            }
        }
        &self.mono
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use symphonia::core::audio::{AudioSpec, layouts};

    #[test]
    fn mean_of_the_channels_and_silence_for_the_impossible() {
        let mut buffer = AudioBuffer::new(AudioSpec::new(8_000, layouts::CHANNEL_LAYOUT_STEREO), 5);
        for frame in [[0.5, -0.25], [1.0, 1.0], [f32::NAN, 0.0], [f32::INFINITY, 0.0], [1e9, 0.0]] {
            buffer.render(Some(1), &frame);
        }
        let mut downmix = Downmix::default();
        assert_eq!(downmix.mean(&buffer), [0.125, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(downmix.impossible, 3);
    }
}
