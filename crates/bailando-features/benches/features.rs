//! Each stage of the feature chain alone, on ten seconds of noise and clicks, with one thread:
//! `cargo bench -p bailando-features`.

use std::hint::black_box;

use bailando_audio::Resampler;
use bailando_features::{FeatureExtractor, ONSET_COLUMN, Profile, Rate};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};

const SECONDS: usize = 10;
const UPLOAD_HZ: u32 = 44_100;

/// Noise with a click twice a second.
fn song(rate: u32) -> Vec<f32> {
    let mut state = 0x9e37_79b9_u32;
    (0..SECONDS * rate as usize)
        .map(|sample| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            let noise = state as f32 / u32::MAX as f32 - 0.5;
            let since_click = sample % (rate as usize / 2);
            let click = (-40.0 * since_click as f32 / rate as f32).exp();
            0.1 * noise + noise * click
        })
        .collect()
}

fn resampling(criterion: &mut Criterion) {
    let input = song(UPLOAD_HZ);
    let mut group = criterion.benchmark_group("resample");
    for rate in [Rate::Conditioning, Rate::Beats] {
        group.bench_function(BenchmarkId::from_parameter(rate.hz()), |bencher| {
            bencher.iter(|| {
                let mut output = Vec::new();
                let mut resampler = Resampler::new(UPLOAD_HZ, rate.hz());
                resampler.process(black_box(&input), &mut output);
                resampler.finish(&mut output);
                output
            });
        });
    }
}

fn features(criterion: &mut Criterion) {
    for rate in [Rate::Conditioning, Rate::Beats] {
        let input = song(rate.hz());
        let mut extractor = FeatureExtractor::new(rate, Profile::Librosa011);
        let Ok(stages) = extractor.extract_stages(&input) else {
            continue;
        };
        let onset = stages.features.column(ONSET_COLUMN).to_vec();
        let mut group = criterion.benchmark_group(format!("{} Hz", rate.hz()));
        group.bench_function("spectra", |bencher| {
            bencher.iter(|| extractor.stft_magnitudes(black_box(&input), usize::MAX).is_ok());
        });
        group.bench_function("constant-Q", |bencher| {
            bencher.iter(|| extractor.cqt(black_box(&input), 0.1).is_ok());
        });
        group.bench_function("beats of an onset envelope", |bencher| {
            bencher.iter(|| extractor.beats_of_onset(black_box(&onset)));
        });
        group.bench_function("beats", |bencher| {
            bencher.iter(|| extractor.beats(black_box(&input)).is_ok());
        });
        group.bench_function("all columns", |bencher| {
            bencher.iter(|| extractor.extract(black_box(&input)).is_ok());
        });
    }
}

criterion_group! {
    name = stages;
    config = Criterion::default().sample_size(20);
    targets = resampling, features
}
criterion_main!(stages);
