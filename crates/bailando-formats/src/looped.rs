//! A clip of whole bars, and one that can be played again and again.

use std::ops::Range;

use bailando_motion::{Animation, PositionsSource, best_loop, close_loop, forward};
use ndarray::{Axis, Slice};

use crate::{
    codes::Codes,
    error::FormatError,
    motion::{GeneratedMotion, Timings},
};

/// A search that was not told how many dances to look at ends when it has compared so many places,
const PLACES: usize = 32;
/// or looked at so many dances.
pub const MOST_LOOP_DANCES: usize = 4;

/// Which whole bars of a motion are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoopOptions {
    /// How many bars.
    pub bars: usize,
    /// Whether the end flows into the start.
    pub closes: bool,
    /// Whether feet are held in place again.
    pub planted: bool,
    /// In how many dances they are looked for; until 32 places were compared, in four dances at
    /// most, if none.
    pub dances: Option<usize>,
}

/// The search for so many bars whose end is most like their start, in dances to one song.
#[derive(Clone, Debug)]
pub struct LoopSearch {
    options: LoopOptions,
    /// What was compared.
    dances: usize,
    places: usize,
    timings: Timings,
    /// Seed of the first dance, with which all come again.
    seed: u64,
    best: Option<Found>,
}

/// A place in a dance.
#[derive(Clone, Debug)]
struct Found {
    /// How much its end differs from its start, as [`best_loop`] measures it.
    difference: f32,
    part: Range<usize>,
    dance: GeneratedMotion,
}

impl LoopSearch {
    /// Before the first dance.
    #[must_use]
    pub fn new(options: LoopOptions) -> Self {
        let timings = Timings::default();
        Self { options, dances: 0, places: 0, timings, seed: 0, best: None }
    }

    /// Compares the places of one more dance, by its own music: where a bar begins and so many
    /// end inside it.
    ///
    /// # Errors
    /// [`FormatError::Bars`] if the music has fewer bars, [`FormatError::Inconsistent`] if the
    /// motion's parts do not fit each other.
    pub fn consider(&mut self, dance: GeneratedMotion) -> Result<(), FormatError> {
        dance.check()?;
        let bars = self.options.bars;
        let parts = dance.parts_of(bars);
        let best = best_loop(&dance.animation, &parts);
        let Some((difference, part)) =
            best.and_then(|(best, difference)| Some((difference, parts.get(best)?.clone())))
        else {
            let found = dance.music.as_ref().map_or(0, |music| music.downbeats_s.len());
            return Err(FormatError::Bars { bars, found: found.saturating_sub(1) });
        };
        if self.dances == 0 {
            self.seed = dance.seed;
        }
        self.dances += 1;
        self.places += parts.len();
        self.timings += dance.timings;
        if self.best.as_ref().is_none_or(|best| difference < best.difference) {
            self.best = Some(Found { difference, part, dance });
        }
        Ok(())
    }

    /// How many dances were compared.
    #[must_use]
    pub fn dances(&self) -> usize {
        self.dances
    }

    /// Whether one more dance is to be compared.
    #[must_use]
    pub fn needs_another(&self) -> bool {
        match self.options.dances {
            Some(dances) => self.dances < dances,
            None => self.dances < MOST_LOOP_DANCES && self.places < PLACES,
        }
    }

    /// Returns the best bars: a clip that begins with a bar and is as long as they are, to the
    /// frame; none before a dance was compared. Nothing continues it. Its seed is that of the first
    /// dance, its timings are those of all.
    ///
    /// # Errors
    /// [`FormatError::Motion`] if they cannot be made a loop.
    pub fn finish(self) -> Result<Option<GeneratedMotion>, FormatError> {
        let Some(Found { difference, part, dance }) = self.best else { return Ok(None) };
        let mut clip = dance.cut(&part);
        if self.options.closes {
            let planted = self.options.planted;
            let closed = close_loop(&dance.skeleton, &dance.animation, part, planted);
            clip.animation = closed.map_err(FormatError::Motion)?;
            let positions = forward(&dance.skeleton, &clip.animation);
            clip.positions = positions.map_err(FormatError::Motion)?;
            clip.positions_source = PositionsSource::ForwardKinematics;
        }
        clip.warnings.push(format!(
            "these bars end most like they begin, of {} places in {} dances: by {difference:.2} \
             radians over all joints; their dance has the seed {}",
            self.places, self.dances, dance.seed
        ));
        Ok(Some(GeneratedMotion { seed: self.seed, timings: self.timings, ..clip }))
    }
}

impl GeneratedMotion {
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
            song_start_s: self.song_start_s + start,
            continuation: None,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use bailando_motion::Skeleton;
    use glam::{Quat, Vec3};
    use ndarray::Array3;

    use super::*;
    use crate::motion::MusicInfo;

    /// Three bars of half a second each of one bone that moves so many metres in each of them.
    fn dance(seed: u64, steps: [f32; 3]) -> GeneratedMotion {
        let frames = 100;
        let place = |frame: usize| {
            let bars = frame as f32 / 30.0;
            let walked = |(bar, step): (usize, &f32)| (bars - bar as f32).clamp(0.0, 1.0) * step;
            Vec3::new(steps.iter().enumerate().map(walked).sum(), 1.0, 0.0)
        };
        let root: Vec<Vec3> = (0..frames).map(place).collect();
        let at = |(frame, _, axis): (usize, usize, usize)| root[frame][axis];
        GeneratedMotion {
            model: "one bone".into(),
            seed,
            skeleton: Skeleton {
                joints: vec!["pelvis".into()],
                parents: vec![-1],
                offsets: vec![[0.0; 3]],
                root_height: 1.0,
            },
            positions: Array3::from_shape_fn((frames, 1, 3), at),
            animation: Animation { fps: 60, rotations: vec![vec![Quat::IDENTITY]; frames], root },
            positions_source: PositionsSource::ForwardKinematics,
            codes: Codes::default(),
            style: None,
            music: Some(MusicInfo {
                downbeats_s: vec![0.0, 0.5, 1.0, 1.5],
                ..MusicInfo::default()
            }),
            timings: Timings { motion: std::time::Duration::from_millis(5), ..Timings::default() },
            warnings: Vec::new(),
            song_start_s: 10.0,
            continuation: None,
        }
    }

    fn search(dances: Option<usize>) -> LoopSearch {
        LoopSearch::new(LoopOptions { bars: 1, closes: false, planted: false, dances })
    }

    #[test]
    fn the_best_place_of_all_dances_is_kept() {
        let mut search = search(Some(3));
        for (seed, steps) in [(7, [0.9, 0.4, 0.5]), (8, [0.6, 0.3, 0.1]), (9, [0.2, 0.3, 0.4])] {
            assert!(search.needs_another());
            search.consider(dance(seed, steps)).unwrap();
        }
        assert!(!search.needs_another());
        let clip = search.finish().unwrap().unwrap();
        // The last bar of the second dance: half of 0.1 m, and hardly any change of speed.
        assert_eq!(
            (clip.animation.root.len(), clip.seed, clip.timings.motion.as_millis()),
            (30, 7, 15)
        );
        let walked = clip.animation.root[29].x - clip.animation.root[0].x;
        assert!((walked - 0.1 * 29.0 / 30.0).abs() < 1e-4, "{walked}");
        // The third bar of what was danced to from ten seconds on.
        assert!((clip.song_start_s - 11.0).abs() < 1e-9, "{}", clip.song_start_s);
        let told = clip.warnings.last().unwrap();
        assert!(told.contains("9 places in 3 dances") && told.contains("the seed 8"), "{told}");
    }

    #[test]
    fn a_search_ends_when_there_were_places_enough() {
        let mut short = search(None);
        for dances in 0..MOST_LOOP_DANCES {
            assert!(short.needs_another(), "{dances}");
            short.consider(dance(1, [0.1; 3])).unwrap();
        }
        assert!(!short.needs_another());
        let mut long = dance(1, [0.1; 3]);
        if let Some(music) = &mut long.music {
            music.downbeats_s = (0..=PLACES).map(|bar| bar as f64 * 0.04).collect();
        }
        let mut search = search(None);
        search.consider(long).unwrap();
        assert!(!search.needs_another());
        let few = LoopOptions { bars: 4, closes: true, planted: true, dances: None };
        let found = LoopSearch::new(few).consider(dance(1, [0.1; 3]));
        assert!(matches!(found, Err(FormatError::Bars { bars: 4, found: 3 })));
    }
}
