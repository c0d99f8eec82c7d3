//! A clip of whole bars, and one that can be played again and again.

use std::ops::Range;

use bailando_motion::{Animation, PositionsSource, best_loop, close_loop, forward};
use ndarray::{Axis, Slice};

use crate::{codes::Codes, error::FormatError, motion::GeneratedMotion};

/// Which whole bars of a motion are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoopOptions {
    /// How many bars.
    pub bars: usize,
    /// Whether the end flows into the start.
    pub closes: bool,
    /// Whether feet are held in place again.
    pub planted: bool,
}

impl GeneratedMotion {
    /// Keeps so many bars: those whose end is most like their start, by the motion's own music. The
    /// clip begins with a bar and is as long as they are, to the frame. Nothing continues it.
    ///
    /// # Errors
    /// [`FormatError::Bars`] if the music has fewer bars, [`FormatError::Inconsistent`] if the
    /// motion's parts do not fit each other.
    pub fn into_loop(self, options: LoopOptions) -> Result<Self, FormatError> {
        self.check()?;
        let LoopOptions { bars, closes, planted } = options;
        let parts = self.parts_of(bars);
        let Some(part) = best_loop(&self.animation, &parts).and_then(|best| parts.get(best)) else {
            let found = self.music.as_ref().map_or(0, |music| music.downbeats_s.len());
            return Err(FormatError::Bars { bars, found: found.saturating_sub(1) });
        };
        let mut clip = self.cut(part);
        if closes {
            let part = part.clone();
            let closed = close_loop(&self.skeleton, &self.animation, part, planted);
            clip.animation = closed.map_err(FormatError::Motion)?;
            let positions = forward(&self.skeleton, &clip.animation);
            clip.positions = positions.map_err(FormatError::Motion)?;
            clip.positions_source = PositionsSource::ForwardKinematics;
        }
        Ok(clip)
    }

    /// Frames of every row of so many bars.
    fn parts_of(&self, bars: usize) -> Vec<Range<usize>> {
        let fps = f64::from(self.animation.fps);
        let frame = |seconds: &f64| (seconds * fps).round().max(0.0) as usize;
        let bounds = self.music.as_ref().map_or(&[][..], |music| &music.downbeats_s);
        let ends = bounds.iter().skip(bars);
        bounds.iter().zip(ends).map(|(start, end)| frame(start)..frame(end)).collect()
    }

    fn cut(&self, part: &Range<usize>) -> Self {
        let fps = f64::from(self.animation.fps);
        let [start, end] = [part.start, part.end].map(|frame| frame as f64 / fps);
        // Half a frame: bounds were rounded.
        let inside = |times: &[f64]| {
            let times = times.iter().filter(|&&time| time > start - 0.5 / fps);
            let times = times.filter(|&&time| time < end - 0.5 / fps);
            times.map(|time| (time - start).max(0.0)).collect()
        };
        let mut music = self.music.clone();
        if let Some(music) = &mut music {
            music.beats_s = inside(&music.beats_s);
            music.downbeats_s = inside(&music.downbeats_s);
        }
        let frames = self.animation.root.len();
        let of_part = |codes: &[u32]| {
            let end = (part.end * codes.len()).div_ceil(frames);
            codes.get(part.start * codes.len() / frames..end).unwrap_or_default().to_vec()
        };
        let positions = self.positions.slice_axis(Axis(0), Slice::from(part.clone())).to_owned();
        let mut warnings = self.warnings.clone();
        warnings.push(format!("the clip is from {start:.2} to {end:.2} s of what was danced to"));
        Self {
            animation: Animation {
                fps: self.animation.fps,
                root: self.animation.root[part.clone()].to_vec(),
                rotations: self.animation.rotations[part.clone()].to_vec(),
            },
            positions,
            codes: Codes { upper: of_part(&self.codes.upper), lower: of_part(&self.codes.lower) },
            music,
            warnings,
            continuation: None,
            ..self.clone()
        }
    }
}
