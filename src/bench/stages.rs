//! Each stage of a generation by itself.

use super::{
    BenchOptions,
    clock::{median, quantile},
    error::Result,
    report::Stage,
};
use crate::{
    CancelToken,
    audio::{self, AudioLimits, AudioRange},
    engine::{Engine, GenerationOptions, GenerationRequest},
    features::{FeatureExtractor, Profile, Rate},
    formats::{BvhUnit, Dance, to_bvh},
};

/// The seed of all dances.
const SEED: u64 = 1;

pub(super) fn measure(
    engine: &Engine,
    options: &BenchOptions,
    threads: usize,
) -> Result<Vec<Stage>> {
    let mut stages = Vec::new();
    let mut stage = |name: &str, threads: usize, seconds: f64| {
        stages.push(Stage {
            name: name.to_owned(),
            threads,
            seconds,
        });
    };
    let decode = |rates: &[Rate]| {
        let rates: Vec<u32> = rates.iter().map(|rate| rate.hz()).collect();
        let (song, limits) = (options.song.clone(), AudioLimits::default());
        let range = AudioRange::default();
        audio::decode(song, range, &rates, &limits, &CancelToken::new())
    };
    let both = [Rate::Conditioning, Rate::Beats];
    for rate in both {
        let seconds = median(options.repeats, || decode(&[rate]))?;
        stage(&format!("decode_resample_{}", rate.hz()), 1, seconds);
    }
    stage(
        "decode_resample_both",
        2,
        median(options.repeats, || decode(&both))?,
    );
    let decoded = decode(&both)?;
    for (rate, signal) in both.into_iter().zip(&decoded.signals) {
        let mut extractor = FeatureExtractor::new(rate, Profile::Librosa011);
        let seconds = median(options.repeats, || extractor.extract(signal))?;
        stage(&format!("features_{}", rate.hz()), 1, seconds);
        if rate == Rate::Beats {
            let seconds = median(options.repeats, || extractor.beats(signal))?;
            stage("beats", 2, seconds);
        }
    }

    let generation = GenerationOptions {
        seed: Some(SEED),
        ..GenerationOptions::default()
    };
    let generate = |generation: &GenerationOptions| -> Result<Dance> {
        let request = GenerationRequest::audio(options.song.clone(), generation.clone());
        Ok(engine.generate(request)?.into_dance(engine.manifest()))
    };
    let mut dance = generate(&generation)?;
    let [mut decode, mut features, mut inference, mut motion] = [const { Vec::new() }; 4];
    let whole = median(options.repeats, || -> Result<()> {
        dance = generate(&generation)?;
        let timings = &dance.timings;
        decode.push(timings.decode.as_secs_f64());
        features.push(timings.features.as_secs_f64());
        inference.push(timings.inference.as_secs_f64());
        motion.push(timings.motion.as_secs_f64());
        // What is sent is part of the answer.
        to_bvh(&dance, BvhUnit::Centimetre)?;
        Ok(())
    })?;
    for (name, times) in [
        ("song_decode", decode),
        ("song_features_and_beats", features),
        ("song_codes_and_frames", inference),
        ("song_rotations", motion),
    ] {
        stage(name, threads, quantile(times, 0.5));
    }
    let bvh = median(options.repeats, || to_bvh(&dance, BvhUnit::Centimetre))?;
    stage("song_bvh", 1, bvh);
    stage("song_to_bvh", threads, whole);
    let chosen = GenerationOptions {
        candidates: Some(3),
        ..generation
    };
    let seconds = median(options.repeats, || -> Result<()> {
        to_bvh(&generate(&chosen)?, BvhUnit::Centimetre)?;
        Ok(())
    })?;
    stage("song_to_bvh_three_candidates", threads, seconds);
    Ok(stages)
}
