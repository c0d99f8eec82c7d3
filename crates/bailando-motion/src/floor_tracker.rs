//! Standing on the floor while later frames are still unknown.

use crate::floor::floor_correction;

/// How far ahead feet must be known before a frame is settled, seconds: half of the window that the
/// correction looks at around a frame, and as much again, as its curve is smooth over two windows.
const LOOKAHEAD_SECONDS: f64 = 2.5;
/// How much of the settled past a new curve includes, seconds: six windows; what is before them
/// says nothing about the curve here.
const HINDSIGHT_SECONDS: f64 = 10.0;
/// Length of the blend from one curve to the next, seconds.
const BLEND_SECONDS: f64 = 1.0;
/// Fewer frames than this are not worth a curve of their own, seconds.
const LEAST_SECONDS: f64 = 0.25;

/// The [`floor_correction`] of one motion: of the whole at its end, or, while streaming, from a
/// curve through the frames so far, with a blend from curve to curve that jumps in neither height
/// nor speed.
#[derive(Clone, Debug)]
pub(crate) struct FloorTracker {
    fps: u32,
    streaming: bool,
    heights: Vec<f32>,
    /// Lifts of the settled frames.
    lifts: Vec<f32>,
}

impl FloorTracker {
    /// Creates a tracker that settles everything at the end.
    pub(crate) fn whole(fps: u32) -> Self {
        Self { fps, streaming: false, heights: Vec::new(), lifts: Vec::new() }
    }

    /// Creates a tracker that settles each frame as early as possible.
    pub(crate) fn streaming(fps: u32) -> Self {
        Self { streaming: true, ..Self::whole(fps) }
    }

    fn frames(&self, seconds: f64) -> usize {
        (seconds * f64::from(self.fps)).round() as usize
    }

    /// Takes the heights of the lower foot in the next frames; returns the lifts of the next frames
    /// that are settled.
    pub(crate) fn push(&mut self, heights: Vec<f32>) -> Vec<f32> {
        self.heights.extend(heights);
        let known = self.heights.len();
        let settled = known.saturating_sub(self.frames(LOOKAHEAD_SECONDS));
        let least = self.lifts.len() + self.frames(LEAST_SECONDS);
        if !self.streaming || settled < least {
            return Vec::new();
        }
        self.settle(settled)
    }

    /// Returns the lifts of all frames that are left.
    pub(crate) fn end(&mut self) -> Vec<f32> {
        self.settle(self.heights.len())
    }

    fn settle(&mut self, end: usize) -> Vec<f32> {
        let done = self.lifts.len();
        let first = match self.streaming {
            true => done.saturating_sub(self.frames(HINDSIGHT_SECONDS)),
            false => 0,
        };
        let curve = floor_correction(&self.heights[first..], self.fps);
        let blend = self.blend_into(&curve, first);
        let lifts: Vec<f32> = (1..=end - done)
            .zip(curve.iter().skip(done - first))
            .map(|(frames, lift)| lift + blend.at(frames as f32))
            .collect();
        self.lifts.extend(&lifts);
        lifts
    }

    /// Measures how the last settled lifts differ from `curve`, which begins at frame `first`.
    fn blend_into(&self, curve: &[f32], first: usize) -> Blend {
        let difference = |back: usize| {
            let frame = self.lifts.len().checked_sub(back)?;
            Some(self.lifts[frame] - curve.get(frame.checked_sub(first)?)?)
        };
        let offset = difference(1).unwrap_or(0.0);
        Blend {
            offset,
            rate: difference(2).map_or(0.0, |before| offset - before),
            frames: self.frames(BLEND_SECONDS).max(1) as f32,
        }
    }
}

/// A cubic from the previous curve's distance and speed against the next one to neither.
struct Blend {
    offset: f32,
    rate: f32,
    frames: f32,
}

impl Blend {
    /// Returns what is left of the distance after so many frames.
    fn at(&self, frames: f32) -> f32 {
        let part = (frames / self.frames).min(1.0);
        let rest = (1.0 - part).powi(2);
        self.offset * (1.0 + 2.0 * part) * rest + self.rate * self.frames * part * rest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::STANDING_HEIGHT;

    const FPS: usize = 60;

    /// Feet that step while the body drifts.
    fn heights(seconds: usize) -> Vec<f32> {
        (0..seconds * FPS)
            .map(|frame| {
                let time = frame as f32 / FPS as f32;
                let step = 0.04 * (frame as f32 * 0.11).sin().max(0.0);
                STANDING_HEIGHT + step + 0.2 * (time * 0.5).sin() - 0.02 * time
            })
            .collect()
    }

    #[test]
    fn as_a_whole_it_is_the_correction_itself() {
        let heights = heights(20);
        let mut floor = FloorTracker::whole(FPS as u32);
        assert!(floor.push(heights.clone()).is_empty());
        assert_eq!(floor.end(), floor_correction(&heights, FPS as u32));
    }

    #[test]
    fn in_pieces_it_is_near_the_whole_and_without_jumps() {
        let heights = heights(60);
        let whole = floor_correction(&heights, FPS as u32);
        for piece in [64, 200, 1024, 10_000] {
            let mut floor = FloorTracker::streaming(FPS as u32);
            let pieces = heights.chunks(piece).map(<[f32]>::to_vec);
            let mut lifts: Vec<f32> = pieces.flat_map(|piece| floor.push(piece)).collect();
            lifts.extend(floor.end());
            assert_eq!(lifts.len(), heights.len());
            let distances = lifts.iter().zip(&whole).map(|(a, b)| (a - b).abs());
            let worst = distances.fold(0.0, f32::max);
            assert!(worst < 0.02, "pieces of {piece}: {worst} m");
            for three in lifts.windows(3) {
                let rate = (three[1] - three[0]).abs() * FPS as f32;
                let change = (three[2] - 2.0 * three[1] + three[0]).abs() * (FPS * FPS) as f32;
                assert!(rate < 0.4, "pieces of {piece}: {rate} m/s");
                assert!(change < 2.0, "pieces of {piece}: {change} m/s^2");
            }
        }
    }

    #[test]
    fn a_frame_is_settled_when_enough_is_known_after_it() {
        let mut floor = FloorTracker::streaming(FPS as u32);
        assert!(floor.push(heights(2)).is_empty());
        let settled = floor.push(heights(1)).len();
        assert_eq!(settled, (0.5 * FPS as f32) as usize);
        let more = floor.push(heights(1)).len();
        assert_eq!(settled + more, (1.5 * FPS as f32) as usize);
    }
}
