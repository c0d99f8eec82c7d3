//! Decoded packets to mono: the mean of the channels (FEATURES section 1).

use symphonia::core::audio::GenericAudioBufferRef;

/// Loudest sample taken as it is, relative to full scale; decoders of floating-point formats can
/// put out anything when a file is damaged.
const LOUDEST: f32 = 1000.0;

/// Mixes packets to mono into a buffer of its own.
#[derive(Debug, Default)]
pub(super) struct Downmix {
    interleaved: Vec<f32>,
    mono: Vec<f32>,
    /// Frames replaced by silence because a sample was not a number or far beyond full scale.
    pub(super) impossible: usize,
}

impl Downmix {
    /// The mono signal of `packet`: integers are scaled by their full scale (16 bit: 1/32768).
    pub(super) fn mix(&mut self, packet: &GenericAudioBufferRef<'_>) -> &[f32] {
        packet.copy_to_vec_interleaved(&mut self.interleaved);
        self.mean(packet.spec().channels().count().max(1))
    }

    fn mean(&mut self, channels: usize) -> &[f32] {
        let share = 1.0 / channels as f32;
        self.mono.clear();
        self.mono.extend(
            self.interleaved
                .chunks_exact(channels)
                .map(|frame| frame.iter().sum::<f32>() * share),
        );
        for sample in &mut self.mono {
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

    #[test]
    fn mean_of_the_channels_and_silence_for_the_impossible() {
        let mut downmix = Downmix {
            interleaved: vec![
                0.5,
                -0.25,
                1.0,
                1.0,
                f32::NAN,
                0.0,
                f32::INFINITY,
                0.0,
                1e9,
                0.0,
            ],
            ..Downmix::default()
        };
        assert_eq!(downmix.mean(2), [0.125, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(downmix.impossible, 3);
    }
}
