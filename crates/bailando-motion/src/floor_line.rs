//! Standing on the floor while later frames are still unknown.

use super::floor_correction;

/// How far ahead feet must be known before a frame is settled, seconds: half of the window that the
/// correction looks at around a frame, and as much again, as its curve is smooth over two windows.
const LOOKAHEAD_SECONDS: f64 = 2.5;
/// How much of what has left is looked at again, seconds: six windows; what is before them says nothing
/// about the curve here.
const HINDSIGHT_SECONDS: f64 = 10.0;
/// How long the step to a curve that knows more takes, seconds.
const BLEND_SECONDS: f64 = 1.0;
/// Fewer frames than this are not worth a curve of their own, seconds.
const LEAST_SECONDS: f64 = 0.25;

/// The [`floor_correction`] of one dance: known as a whole at its end, or frame by frame from a curve
/// through what is known so far, without jumps in height or speed where one curve follows another.
#[derive(Clone, Debug)]
pub(super) struct FloorLine {
    fps: u32,
    as_known: bool,
    heights: Vec<f32>,
    /// What was said of the frames that have left.
    lifts: Vec<f32>,
}

impl FloorLine {
    /// `as_known`: frame by frame, as far as it can be known; else everything at the end.
    pub(super) fn new(fps: u32, as_known: bool) -> Self {
        Self {
            fps,
            as_known,
            heights: Vec::new(),
            lifts: Vec::new(),
        }
    }

    fn frames(&self, seconds: f64) -> usize {
        (seconds * f64::from(self.fps)).round() as usize
    }

    /// Heights of the lower foot in the next frames; what to add to the next that are settled.
    pub(super) fn push(&mut self, heights: Vec<f32>) -> Vec<f32> {
        self.heights.extend(heights);
        let known = self.heights.len();
        let settled = known.saturating_sub(self.frames(LOOKAHEAD_SECONDS));
        let least = self.lifts.len() + self.frames(LEAST_SECONDS);
        if !self.as_known || settled < least {
            return Vec::new();
        }
        self.settle(settled)
    }

    /// What to add to the rest.
    pub(super) fn end(&mut self) -> Vec<f32> {
        self.settle(self.heights.len())
    }

    fn settle(&mut self, end: usize) -> Vec<f32> {
        let done = self.lifts.len();
        let first = match self.as_known {
            true => done.saturating_sub(self.frames(HINDSIGHT_SECONDS)),
            false => 0,
        };
        let heights = self.heights.get(first..).unwrap_or_default();
        let curve = floor_correction(heights, self.fps);
        let step = self.step_to(&curve, first);
        let blend = self.frames(BLEND_SECONDS).max(1) as f32;
        let lifts: Vec<f32> = (done..end)
            .zip(curve.iter().skip(done - first))
            .map(|(frame, lift)| {
                let part = ((frame + 1 - done) as f32 / blend).min(1.0);
                lift + step.left(part, blend)
            })
            .collect();
        self.lifts.extend(&lifts);
        lifts
    }

    /// What was said last, less what `curve`, which begins at frame `first`, says of the same frame.
    fn step_to(&self, curve: &[f32], first: usize) -> Step {
        let apart = |back: usize| {
            let frame = self.lifts.len().checked_sub(back)?;
            let said = self.lifts.get(frame)?;
            Some(said - curve.get(frame.checked_sub(first)?)?)
        };
        let offset = apart(1).unwrap_or(0.0);
        Step {
            offset,
            rate: apart(2).map_or(0.0, |before| offset - before),
        }
    }
}

/// How far a curve lies from the one before it, and how that changes per frame.
struct Step {
    offset: f32,
    rate: f32,
}

impl Step {
    /// What is left of the step after this part of `frames`: it ends with neither height nor speed.
    fn left(&self, part: f32, frames: f32) -> f32 {
        let rest = (1.0 - part).powi(2);
        self.offset * (1.0 + 2.0 * part) * rest + self.rate * frames * part * rest
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

    fn in_pieces(heights: &[f32], piece: usize) -> Vec<f32> {
        let mut line = FloorLine::new(FPS as u32, true);
        let mut lifts = Vec::new();
        for piece in heights.chunks(piece) {
            lifts.extend(line.push(piece.to_vec()));
        }
        lifts.extend(line.end());
        lifts
    }

    #[test]
    fn known_at_the_end_it_is_the_correction_itself() {
        let heights = heights(20);
        let mut line = FloorLine::new(FPS as u32, false);
        assert!(line.push(heights.clone()).is_empty());
        assert_eq!(line.end(), floor_correction(&heights, FPS as u32));
    }

    #[test]
    fn in_pieces_it_is_near_the_whole_and_without_jumps() {
        let heights = heights(60);
        let whole = floor_correction(&heights, FPS as u32);
        for piece in [64, 200, 1024, 10_000] {
            let lifts = in_pieces(&heights, piece);
            assert_eq!(lifts.len(), heights.len());
            let apart = |(a, b): (&f32, &f32)| (a - b).abs();
            let worst = lifts.iter().zip(&whole).map(apart).fold(0.0, f32::max);
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
    fn a_frame_leaves_when_enough_is_known_behind_it() {
        let mut line = FloorLine::new(FPS as u32, true);
        assert!(line.push(heights(2)).is_empty());
        let left = line.push(heights(1)).len();
        assert_eq!(left, (0.5 * FPS as f32) as usize);
        let more = line.push(heights(1)).len();
        assert_eq!(left + more, (1.5 * FPS as f32) as usize);
    }
}
