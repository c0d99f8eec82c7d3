//! Harmonic and percussive part by median filtering (FEATURES section 4).
//!
//! One pass over the song: only the frames under the median along time are held, and rebuilt
//! samples take the place of those that no later frame needs.

use std::ops::Range;

use bailando_core::{CancelToken, dsp::vectorised};
use rustfft::num_complex::Complex;

use crate::{
    istft::{FrameOf, OverlapAdd},
    layout::{HOP, row_count},
    median::{LANES, SlidingMedians, WINDOW},
    padding::{Padding, mirror_between_samples},
    stft::{BINS, Stft, magnitudes},
};

const HALF_WINDOW: usize = WINDOW / 2;
// The window of one frame and the frame that has just left it.
const HELD_FRAMES: usize = WINDOW + 1;
/// Bins that each of the windows along frequency slides over.
const SEGMENT: usize = BINS.div_ceil(LANES);
/// Bins of all of them; those beyond [`BINS`] are not used.
const WHOLE_LANES: usize = SEGMENT * LANES;

/// Separator of a signal into two parts that add up to it.
pub(crate) struct Separator {
    stft: Stft,
    silent_tail: bool,
    held_spectra: Vec<Complex<f32>>,
    held_magnitudes: Vec<f32>,
    along_time: SlidingMedians,
    /// A frame as the median along frequency sees it, both ends mirrored.
    mirrored: Vec<f32>,
    along_frequency: SlidingMedians,
    percussive_median: Vec<f32>,
    masked: Vec<Complex<f32>>,
    harmonic: OverlapAdd,
    percussive: OverlapAdd,
}

impl Separator {
    /// `silent_tail`: samples after the middle of the last frame are zero (FEATURES section 11.3).
    pub(crate) fn new(padding: Padding, silent_tail: bool) -> Self {
        Self {
            stft: Stft::hann(padding),
            silent_tail,
            held_spectra: vec![Complex::default(); HELD_FRAMES * BINS],
            held_magnitudes: vec![0.0; HELD_FRAMES * WHOLE_LANES],
            along_time: SlidingMedians::new(WHOLE_LANES),
            mirrored: vec![0.0; HALF_WINDOW + WHOLE_LANES + HALF_WINDOW],
            along_frequency: SlidingMedians::new(LANES),
            percussive_median: vec![0.0; WHOLE_LANES],
            masked: vec![Complex::default(); BINS],
            harmonic: OverlapAdd::new(),
            percussive: OverlapAdd::new(),
        }
    }

    /// Leaves the percussive part of `signal` in its place and writes the other part to `harmonic`,
    /// which is as long, where given. Shows the magnitudes of each frame, in order, to
    /// `on_magnitudes`. Once `cancel` is triggered, the rest stays as it is.
    pub(crate) fn split(
        &mut self,
        signal: &mut [f32],
        mut harmonic: Option<&mut [f32]>,
        cancel: &CancelToken,
        mut on_magnitudes: impl FnMut(usize, &[f32]),
    ) {
        let count = row_count(signal.len());
        let mut analysed = 0;
        for index in (0..count).take_while(|_| !cancel.is_cancelled()) {
            while analysed < count.min(index + HALF_WINDOW + 1) {
                self.analyse(signal, analysed);
                on_magnitudes(analysed, self.magnitudes_of(analysed));
                analysed += 1;
            }
            self.slide_along_time(index, count);
            self.slide_along_frequency(index);
            let frame = FrameOf { index, count };
            if let Some(harmonic_part) = harmonic.as_deref_mut() {
                self.mask(index, soft_mask);
                self.harmonic.push(&self.masked, frame, harmonic_part);
            }
            self.mask(index, |harmonic, percussive| soft_mask(percussive, harmonic));
            // The samples that it completes end half a window of frames before the next frame's.
            self.percussive.push(&self.masked, frame, signal);
        }
        if self.silent_tail {
            for part in [Some(signal), harmonic].into_iter().flatten() {
                if let Some(tail) = part.get_mut(HOP * (count - 1)..) {
                    tail.fill(0.0);
                }
            }
        }
    }

    fn analyse(&mut self, pcm: &[f32], frame: usize) {
        let spectrum = &mut self.held_spectra[spectrum_range(frame)];
        self.stft.frame(pcm, frame * HOP, spectrum);
        let held = &mut self.held_magnitudes[magnitudes_range(frame)];
        magnitudes(spectrum, &mut held[..BINS]);
    }

    fn magnitudes_of(&self, frame: usize) -> &[f32] {
        &self.held_magnitudes[magnitudes_range(frame)][..BINS]
    }

    fn slide_along_time(&mut self, frame: usize, frames: usize) {
        let magnitudes = |index: isize| {
            let frame = mirror_between_samples(index, frames);
            &self.held_magnitudes[magnitudes_range(frame)]
        };
        let (frame, half) = (frame as isize, HALF_WINDOW as isize);
        if frame == 0 {
            self.along_time.fill(|index| magnitudes(index as isize - half));
        } else {
            self.along_time.exchange(magnitudes(frame - half - 1), magnitudes(frame + half));
        }
    }

    /// The windows begin a segment apart and slide over one each.
    fn slide_along_frequency(&mut self, frame: usize) {
        self.mirror(frame);
        let mirrored = &self.mirrored;
        let lanes = |index: usize| -> [f32; LANES] {
            std::array::from_fn(|lane| mirrored[lane * SEGMENT + index])
        };
        self.along_frequency.fill(lanes);
        for step in 0..SEGMENT {
            if step > 0 {
                self.along_frequency.exchange(&lanes(step - 1), &lanes(step + WINDOW - 1));
            }
            for (lane, &median) in self.along_frequency.medians().iter().enumerate() {
                self.percussive_median[lane * SEGMENT + step] = median;
            }
        }
    }

    fn mirror(&mut self, frame: usize) {
        let row = &self.held_magnitudes[magnitudes_range(frame)];
        let (before, rest) = self.mirrored.split_at_mut(HALF_WINDOW);
        let (inside, after) = rest.split_at_mut(BINS);
        inside.copy_from_slice(&row[..BINS]);
        for (value, bin) in before.iter_mut().rev().zip(1_isize..) {
            *value = row[mirror_between_samples(-bin, BINS)];
        }
        for (value, bin) in after.iter_mut().zip(BINS as isize..) {
            *value = row[mirror_between_samples(bin, BINS)];
        }
    }

    fn mask(&mut self, frame: usize, mask: impl Fn(f32, f32) -> f32) {
        let spectrum = &self.held_spectra[spectrum_range(frame)];
        vectorised(
            #[inline(always)]
            || {
                for (((masked, &bin), &harmonic), &percussive) in self
                    .masked
                    .iter_mut()
                    .zip(spectrum)
                    .zip(self.along_time.medians())
                    .zip(&self.percussive_median)
                {
                    *masked = bin * mask(harmonic, percussive);
                }
            },
        );
    }
}

/// Where a frame's spectrum lies in the ring of held frames.
fn spectrum_range(frame: usize) -> Range<usize> {
    let start = (frame % HELD_FRAMES) * BINS;
    start..start + BINS
}

/// Where a frame's magnitudes lie in the ring of held magnitudes.
fn magnitudes_range(frame: usize) -> Range<usize> {
    let start = (frame % HELD_FRAMES) * WHOLE_LANES;
    start..start + WHOLE_LANES
}

/// Share of `part` against `other`, by power; half each where there is nothing.
fn soft_mask(part: f32, other: f32) -> f32 {
    let larger = part.max(other);
    if larger < f32::MIN_POSITIVE {
        return 0.5;
    }
    let (part, other) = (part / larger, other / larger);
    let (part, other) = (part * part, other * other);
    part / (part + other)
}

#[cfg(test)]
mod tests {
    use bailando_testkit::sound::noise;

    use super::*;

    #[test]
    fn masks_share_by_power() {
        assert_eq!(soft_mask(0.0, 0.0), 0.5);
        assert_eq!(soft_mask(3.0, 0.0), 1.0);
        assert!((soft_mask(1.0, 2.0) - 0.2).abs() < 1e-7);
    }

    #[test]
    fn the_parts_add_up_to_the_signal() {
        // Shorter than, about as long as, and longer than the median's window.
        for samples in [1_100, 15_000, 40_000] {
            let pcm = noise(samples);
            let mut separator = Separator::new(Padding::Zeros, false);
            let (mut percussive, mut harmonic) = (pcm.clone(), vec![0.0; samples]);
            let cancel = &CancelToken::new();
            separator.split(&mut percussive, Some(&mut harmonic), cancel, |_, _| {});
            for ((h, p), x) in harmonic.iter().zip(&percussive).zip(&pcm) {
                assert!((h + p - x).abs() < 5e-6);
            }
            let mut alone = pcm;
            separator.split(&mut alone, None, cancel, |_, _| {});
            assert_eq!(alone, percussive);
        }
    }

    #[test]
    fn both_medians_equal_sorting_at_every_cell() {
        for samples in [1_100, 9_000, 24_000] {
            let pcm = noise(samples);
            let frames = row_count(samples);
            let mut separator = Separator::new(Padding::Zeros, false);
            let mut rows = Vec::new();
            separator.split(&mut pcm.clone(), None, &CancelToken::new(), |_, row| {
                rows.push(row.to_vec());
            });
            assert_eq!(rows.len(), frames);
            let sorted_median = |mut values: Vec<f32>| {
                values.sort_by(f32::total_cmp);
                values[HALF_WINDOW]
            };
            let mut analysed = 0;
            for frame in 0..frames {
                while analysed < frames.min(frame + HALF_WINDOW + 1) {
                    separator.analyse(&pcm, analysed);
                    analysed += 1;
                }
                separator.slide_along_time(frame, frames);
                separator.slide_along_frequency(frame);
                for bin in [0_usize, 1, 14, 15, 500, 1_010, 1_023, 1_024] {
                    let window = -15_isize..=15;
                    let along_time = window
                        .clone()
                        .map(|d| rows[mirror_between_samples(frame as isize + d, frames)][bin])
                        .collect();
                    let median = separator.along_time.medians()[bin];
                    assert_eq!(median, sorted_median(along_time));
                    let along_frequency = window
                        .map(|d| rows[frame][mirror_between_samples(bin as isize + d, BINS)])
                        .collect();
                    let median = separator.percussive_median[bin];
                    assert_eq!(median, sorted_median(along_frequency));
                }
            }
        }
    }

    #[test]
    fn the_older_profile_ends_in_zeros() {
        let (mut percussive, mut harmonic) = (noise(5_000), vec![0.0; 5_000]);
        let mut separator = Separator::new(Padding::Reflect, true);
        let cancel = &CancelToken::new();
        separator.split(&mut percussive, Some(&mut harmonic), cancel, |_, _| {});
        for part in [percussive, harmonic] {
            assert!(part[4_608..].iter().all(|&x| x == 0.0));
            assert!(part[4_600..4_608].iter().any(|&x| x != 0.0));
        }
    }
}
