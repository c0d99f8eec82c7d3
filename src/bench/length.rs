//! Cost by length: the song over and over, as a file of any length.

use bytes::Bytes;

use super::{clock::timed, error::Result, machine, report::LengthPoint};
use crate::{
    CancelToken,
    audio::{self, AudioLimits, AudioRange},
    engine::{Engine, GenerationOptions, GenerationRequest},
    features::Rate,
    formats::{BvhUnit, to_bvh},
};

/// Bytes of a sample.
const SAMPLE: u32 = 2;

pub(super) fn measure(engine: &Engine, song: &Bytes, seconds: f64) -> Result<LengthPoint> {
    let wav = repeated(song, seconds)?;
    let options = GenerationOptions {
        seed: Some(1),
        ..GenerationOptions::default()
    };
    let (dance, elapsed_s) = timed(|| -> Result<usize> {
        let output = engine.generate(GenerationRequest::audio(wav, options))?;
        let dance = output.into_dance(engine.manifest());
        to_bvh(&dance, BvhUnit::Centimetre)?;
        Ok(dance.animation.root.len())
    });
    Ok(LengthPoint {
        seconds,
        frames: dance?,
        elapsed_s,
        resident_peak_bytes: machine::peak_bytes(),
    })
}

/// The song from its start again and again for so long, as a wav file.
fn repeated(song: &Bytes, seconds: f64) -> Result<Bytes> {
    let rate = Rate::Beats.hz();
    let (range, limits) = (AudioRange::default(), AudioLimits::default());
    let decoded = audio::decode(song.clone(), range, &[rate], &limits, &CancelToken::new())?;
    let signal = decoded.signals.into_iter().next().unwrap_or_default();
    let samples = (seconds * f64::from(rate)) as usize;
    let size = samples as u32 * SAMPLE;
    let mut wav = Vec::with_capacity(44 + size as usize);
    wav.extend_from_slice(b"RIFF");
    wav.extend_from_slice(&(36 + size).to_le_bytes());
    wav.extend_from_slice(b"WAVEfmt ");
    wav.extend_from_slice(&16_u32.to_le_bytes());
    // PCM, one channel.
    wav.extend_from_slice(&1_u16.to_le_bytes());
    wav.extend_from_slice(&1_u16.to_le_bytes());
    wav.extend_from_slice(&rate.to_le_bytes());
    wav.extend_from_slice(&(rate * SAMPLE).to_le_bytes());
    wav.extend_from_slice(&(SAMPLE as u16).to_le_bytes());
    wav.extend_from_slice(&(8 * SAMPLE as u16).to_le_bytes());
    wav.extend_from_slice(b"data");
    wav.extend_from_slice(&size.to_le_bytes());
    for sample in signal.iter().cycle().take(samples) {
        let sample = (sample.clamp(-1.0, 1.0) * f32::from(i16::MAX)) as i16;
        wav.extend_from_slice(&sample.to_le_bytes());
    }
    Ok(wav.into())
}
