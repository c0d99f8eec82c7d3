//! Cost by length: the song repeated to a file of any length.

use bytes::Bytes;

use super::{clock::timed, generator::Generator, machine, report::LengthPoint};
use crate::{
    CancelToken, Result,
    audio::{self, AudioLimits, AudioRange},
    features::Rate,
    formats::{BvhUnit, to_bvh},
};

/// Bytes of a sample.
const SAMPLE: u32 = 2;

pub(super) fn measure(generator: &Generator, seconds: f64) -> Result<LengthPoint> {
    let wav = repeated(&generator.song, seconds)?;
    let (frames, elapsed_s) = timed(|| -> Result<usize> {
        let dance = generator.audio(wav, 1, None)?;
        to_bvh(&dance, BvhUnit::Centimetre)?;
        Ok(dance.animation.root.len())
    });
    Ok(LengthPoint {
        seconds,
        frames: frames?,
        elapsed_s,
        resident_peak_bytes: machine::peak_bytes(),
    })
}

/// Repeats the song until it is so long, as a WAV file of one channel.
fn repeated(song: &Bytes, seconds: f64) -> Result<Bytes> {
    let rate = Rate::Beats.hz();
    let (range, limits) = (AudioRange::default(), AudioLimits::default());
    let decoded = audio::decode(song.clone(), range, &[rate], &limits, &CancelToken::new())?;
    let samples = (seconds * f64::from(rate)) as usize;
    let size = samples as u32 * SAMPLE;
    let mut wav = Vec::with_capacity(44 + size as usize);
    wav.extend(b"RIFF");
    wav.extend((36 + size).to_le_bytes());
    wav.extend(b"WAVEfmt \x10\0\0\0\x01\0\x01\0");
    wav.extend(rate.to_le_bytes());
    wav.extend((rate * SAMPLE).to_le_bytes());
    wav.extend(b"\x02\0\x10\0data");
    wav.extend(size.to_le_bytes());
    for sample in decoded.signals[0].iter().cycle().take(samples) {
        let sample = (sample.clamp(-1.0, 1.0) * f32::from(i16::MAX)) as i16;
        wav.extend(sample.to_le_bytes());
    }
    Ok(wav.into())
}
