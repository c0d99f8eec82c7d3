//! Tempo by a line through the beats: single distances are multiples of a frame.

/// Beats that share a line, and the number after which the next line starts.
const SPAN: usize = 16;
const STEP: usize = 4;
/// Share by which the tempo of a part may differ from that of the whole.
const STEADY: f64 = 0.03;

/// Share by which a usual distance may differ from the median.
const USUAL: f64 = 0.1;

/// Beats per minute, and whether they stay the same; nothing below two beats.
pub(super) fn tempo(beats_s: &[f64]) -> Option<(f64, bool)> {
    let mut distances: Vec<f64> = beats_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    distances.sort_by(f64::total_cmp);
    let median = distances.get(distances.len() / 2).copied().filter(|&median| median > 0.0)?;
    // A beat that was left out, in a pause, leaves its number out.
    let mut number = 0.0;
    let mut numbered = vec![(0.0, *beats_s.first()?)];
    for pair in beats_s.windows(2) {
        number += ((pair[1] - pair[0]) / median).round().max(1.0);
        numbered.push((number, pair[1]));
    }
    let whole = slope(&numbered)?;
    let starts = (0..=numbered.len().saturating_sub(SPAN)).step_by(STEP);
    let parts = starts.map(|start| &numbered[start..(start + SPAN).min(numbered.len())]);
    let mut slopes = parts.filter_map(slope);
    let is_steady = slopes.all(|slope| (slope / whole - 1.0).abs() <= STEADY);
    let mut usual = || {
        distances.retain(|distance| (distance / median - 1.0).abs() <= USUAL);
        distances.iter().sum::<f64>() / distances.len() as f64
    };
    let beat_s = if is_steady { whole } else { usual() };
    (beat_s > 0.0).then_some((60.0 / beat_s, is_steady))
}

/// Seconds per beat of the line of least squares.
fn slope(numbered: &[(f64, f64)]) -> Option<f64> {
    let count = numbered.len() as f64;
    let sum = |of: fn(&(f64, f64)) -> f64| numbered.iter().map(of).sum::<f64>();
    let (number, second) = (sum(|beat| beat.0) / count, sum(|beat| beat.1) / count);
    let (mut squares, mut products) = (0.0, 0.0);
    for beat in numbered {
        squares += (beat.0 - number).powi(2);
        products += (beat.0 - number) * (beat.1 - second);
    }
    (squares > 0.0).then(|| products / squares)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beats in whole frames at 50 a second.
    fn framed(seconds: impl Iterator<Item = f64>) -> Vec<f64> {
        seconds.map(|second| (second * 50.0).round() / 50.0).collect()
    }

    #[test]
    fn the_tempo_is_finer_than_frames() {
        for bpm in [61.3, 128.0, 174.0, 207.5] {
            let beats = framed((0..40).map(|k| 0.3 + f64::from(k) * 60.0 / bpm));
            let (found, is_steady) = tempo(&beats).unwrap();
            assert!((found / bpm - 1.0).abs() < 2e-3 && is_steady, "{bpm}: {found}");
        }
        // A pause of three beats.
        let pause = (0..40).filter(|k| !(17..20).contains(k));
        let (found, is_steady) = tempo(&framed(pause.map(|k| f64::from(k) * 0.5))).unwrap();
        assert!((found - 120.0).abs() < 1e-6 && is_steady);
    }

    #[test]
    fn a_tempo_that_changes_is_not_steady() {
        let rising = (0..40).scan(0.0, |second, k| {
            *second += 60.0 / (80.0 + 2.5 * f64::from(k));
            Some(*second)
        });
        assert!(!tempo(&framed(rising)).unwrap().1);
        let jump = (0..40).map(|k| if k < 14 { 0.75 * k as f64 } else { 4.5 + 0.43 * k as f64 });
        let (found, is_steady) = tempo(&framed(jump)).unwrap();
        assert!(!is_steady && (found - 139.5).abs() < 2.0, "{found}");
    }

    #[test]
    fn fewer_than_two_beats_have_no_tempo() {
        assert_eq!((tempo(&[]), tempo(&[1.0])), (None, None));
        assert_eq!(tempo(&[1.0, 1.5]), Some((120.0, true)));
    }
}
