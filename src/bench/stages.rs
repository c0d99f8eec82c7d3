//! Each stage of a generation alone.

use super::{
    clock::{median, quantile},
    error::Result,
    generator::Generator,
    options::BenchOptions,
    report::Stage,
};
use crate::{
    CancelToken,
    audio::{self, AudioLimits, AudioRange},
    features::{BeatFinder, FeatureExtractor, Profile, Rate},
    formats::{BvhUnit, GeneratedMotion, to_bvh},
    model::{BeatNetwork, ModelDirectory},
};

/// The seed of all generations.
const SEED: u64 = 1;
/// Seconds of motion that the decoder decodes as one chunk.
const DECODED_SECONDS: usize = 30;

fn stage(name: impl Into<String>, threads: usize, seconds: f64) -> Stage {
    Stage { name: name.into(), threads, seconds }
}

pub(super) fn measure(
    generator: &Generator,
    options: &BenchOptions,
    threads: usize,
) -> Result<Vec<Stage>> {
    let mut stages = frontend(options)?;
    stages.extend(generation(generator, options.repeats, threads)?);
    Ok(stages)
}

/// Measures the way from bytes to features and beats.
fn frontend(options: &BenchOptions) -> Result<Vec<Stage>> {
    let repeats = options.repeats;
    let decode_at = |rates: &[u32]| {
        let (song, limits) = (options.song.clone(), AudioLimits::default());
        audio::decode(song, AudioRange::default(), rates, &limits, &CancelToken::new())
    };
    let decode = |rates: &[Rate]| {
        let rates: Vec<u32> = rates.iter().map(|rate| rate.hz()).collect();
        decode_at(&rates)
    };
    let mut stages = Vec::new();
    let both = [Rate::Conditioning, Rate::Beats];
    for rate in both {
        let seconds = median(repeats, || decode(&[rate]))?;
        stages.push(stage(format!("decode_resample_{}", rate.hz()), 1, seconds));
    }
    let seconds = median(repeats, || decode(&both))?;
    stages.push(stage("decode_resample_both", 2, seconds));
    for (rate, signal) in both.into_iter().zip(&decode(&both)?.signals) {
        let mut extractor = FeatureExtractor::new(rate, Profile::Librosa011);
        let seconds = median(repeats, || extractor.extract(signal))?;
        stages.push(stage(format!("features_{}", rate.hz()), 1, seconds));
        if rate == Rate::Beats {
            let seconds = median(repeats, || extractor.beats(signal))?;
            stages.push(stage("beats", 2, seconds));
        }
    }
    let song = decode_at(&[BeatFinder::HZ])?.signals.swap_remove(0);
    let (mut finder, mut network) = (BeatFinder::new(), BeatNetwork::open()?);
    let seconds = median(repeats, || -> Result<_> {
        network.beats(&mut finder, &song, &CancelToken::new())
    })?;
    stages.push(stage("beats_and_bars", 1, seconds));
    Ok(stages)
}

/// Measures whole generations, and the stages that they time themselves.
fn generation(generator: &Generator, repeats: usize, threads: usize) -> Result<Vec<Stage>> {
    // The file is part of the result.
    let to_file = |candidates| -> Result<GeneratedMotion> {
        let dance = generator.song(SEED, candidates)?;
        to_bvh(&dance, BvhUnit::Centimetre)?;
        Ok(dance)
    };
    let mut dances = vec![generator.song(SEED, None)?];
    let whole = median(repeats, || -> Result<()> {
        dances.push(to_file(None)?);
        Ok(())
    })?;
    let timed = |name: &str, seconds: fn(&GeneratedMotion) -> f64| {
        let times = dances.iter().skip(1).map(seconds).collect();
        stage(name, threads, quantile(times, 0.5))
    };
    let bvh = median(repeats, || to_bvh(&dances[0], BvhUnit::Centimetre))?;
    let chosen = median(repeats, || to_file(Some(3)))?;
    Ok(vec![
        timed("song_decode", |dance| dance.timings.decode.as_secs_f64()),
        timed("song_features_and_beats", |dance| dance.timings.features.as_secs_f64()),
        timed("song_codes_and_frames", |dance| dance.timings.inference.as_secs_f64()),
        timed("song_rotations", |dance| dance.timings.motion.as_secs_f64()),
        stage("song_bvh", 1, bvh),
        stage("song_to_bvh", threads, whole),
        stage("song_to_bvh_three_candidates", threads, chosen),
    ])
}

/// Measures the decoder, from codes to frames.
pub(super) fn decoder(directory: &ModelDirectory, repeats: usize, threads: usize) -> Result<Stage> {
    let manifest = directory.manifest();
    let count = (DECODED_SECONDS * manifest.fps as usize).div_ceil(manifest.frames_per_code.max(1));
    let sizes = [manifest.vocabulary.upper, manifest.vocabulary.lower];
    let pair = |step: usize| sizes.map(|size| (step * 7 % size.max(1)) as u32);
    let codes: Vec<_> = (0..count).map(pair).collect();
    let mut decoder = directory.decoder(threads)?;
    let seconds = median(repeats, || decoder.decode(&codes))?;
    Ok(stage(format!("decoder_{DECODED_SECONDS}_s"), threads, seconds))
}
