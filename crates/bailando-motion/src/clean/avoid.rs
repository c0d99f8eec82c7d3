//! The way of an arm around the body: which side, how far, and from when to when.

use std::collections::VecDeque;

use glam::DVec3;

use super::capsule::Capsule;
use crate::smooth::{smooth_largest_at, smooth_step};

/// Seconds over which an arm that must leave the body begins to move away before, and comes back
/// after.
const LEAVING: f64 = 0.1;
/// Furthest that a wrist is moved first, twice as far as after that, metres.
const FURTHEST: f64 = 0.15;
/// Steps from inside a capsule to its surface, each as long as the point is deep: the last is less
/// than a millimetre.
const STEPS: usize = 16;

/// A point that moves with the wrist, by its share of the wrist's way.
pub(super) type ArmPoint = (DVec3, f64);

/// One arm's way around the body in every frame of a motion: one that is smooth, and a second where
/// the first is not enough.
#[derive(Clone, Debug)]
pub(super) struct Avoidance {
    half_width: usize,
    continues: bool,
    /// Frames after those in `rest`.
    shapes: VecDeque<Shape>,
    touches: Vec<Option<Touch>>,
    /// How the wrist must move, as far as that is known, metres.
    ways: Vec<DVec3>,
    /// How it moves first.
    smooth: Vec<DVec3>,
    /// How it must move after that.
    rest: Vec<DVec3>,
}

/// An arm and the body in one frame.
#[derive(Clone, Debug)]
struct Shape {
    points: [ArmPoint; 4],
    capsules: Option<[Capsule; 3]>,
}

/// A frame in which an arm is inside the body.
#[derive(Clone, Copy, Debug)]
struct Touch {
    /// The shortest way out, metres.
    way: DVec3,
    /// Where the forearm passes the middle of the body, as long as the way.
    side: DVec3,
}

impl Avoidance {
    /// For a motion at `fps`, which begins without a way aside if it continues another.
    pub(super) fn new(fps: u32, continues: bool) -> Self {
        Self {
            half_width: (LEAVING * f64::from(fps)).ceil() as usize,
            continues,
            shapes: VecDeque::new(),
            touches: Vec::new(),
            ways: Vec::new(),
            smooth: Vec::new(),
            rest: Vec::new(),
        }
    }

    /// Frames that must be known after one: those that decide the direction of the last of those
    /// that decide how far, twice.
    pub(super) fn lookahead(&self) -> usize {
        3 * self.reach()
    }

    /// Frames on either side of one that decide about it.
    fn reach(&self) -> usize {
        2 * self.half_width
    }

    /// Takes the next frame: points of an arm, the wrist first, and the direction of the forearm.
    pub(super) fn see(
        &mut self,
        points: [ArmPoint; 4],
        forearm: DVec3,
        capsules: Option<[Capsule; 3]>,
    ) {
        let shape = Shape { points, capsules };
        self.touches.push(shape.touch(forearm));
        self.shapes.push_back(shape);
    }

    /// Returns how far the wrist moves in `frame`, which is asked for in order: all of the way out
    /// while the arm is inside, and some of it before and after.
    pub(super) fn way_out(&mut self, frame: usize) -> DVec3 {
        let known = self.touches.len();
        while self.rest.len() < known.min(frame + self.reach() + 1) {
            let at = self.rest.len();
            while self.ways.len() < known.min(at + self.reach() + 1) {
                self.ways.push(self.way(self.ways.len()));
            }
            let way = smooth_largest_at(&self.ways, self.half_width, at);
            let shape = self.shapes.pop_front();
            // An arm that is out and does not move is left alone.
            let shape = shape.filter(|_| way != DVec3::ZERO || self.touches[at].is_some());
            let rest = shape.map_or(DVec3::ZERO, |shape| shape.way_out(way));
            self.rest.push(rest.clamp_length_max(0.5 * FURTHEST));
            self.smooth.push(way);
        }
        let way = self.smooth[frame] + smooth_largest_at(&self.rest, self.half_width, frame);
        match self.continues {
            true => way * smooth_step(frame as f64 / self.half_width as f64),
            false => way,
        }
    }

    /// Decides how the wrist must move in a frame.
    fn way(&self, frame: usize) -> DVec3 {
        if self.touches[frame].is_none() {
            return DVec3::ZERO;
        }
        let direction = self.direction(frame);
        self.shapes[frame - self.rest.len()].exit(direction)
    }

    /// Returns the direction in which the wrist leaves: that of the ways out of the frames around.
    /// Where these cancel, for the arm goes through to the other side, it passes the body on the
    /// side of it on which its forearm is.
    fn direction(&self, frame: usize) -> DVec3 {
        let reach = self.reach();
        let (mut way, mut side, mut length) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        let near = frame.saturating_sub(reach)..self.touches.len().min(frame + reach + 1);
        for other in near {
            let Some(touch) = &self.touches[other] else { continue };
            let weight = ((reach + 1 - other.abs_diff(frame)) as f64).powi(2);
            way += touch.way * weight;
            side += touch.side * weight;
            length += touch.way.length() * weight;
        }
        (way + side.normalize_or_zero() * (length - way.length())).normalize_or_zero()
    }
}

impl Shape {
    fn pairs(&self) -> impl Iterator<Item = (&Capsule, ArmPoint)> {
        let capsules = self.capsules.iter().flatten();
        capsules.flat_map(|capsule| self.points.iter().map(move |&point| (capsule, point)))
    }

    fn touch(&self, forearm: DVec3) -> Option<Touch> {
        let way = self.way_out(DVec3::ZERO);
        if way == DVec3::ZERO {
            return None;
        }
        let sides = self.pairs().map(|(capsule, (point, _))| {
            capsule.side_of(point, forearm) * capsule.way_out(point).length()
        });
        let side = sides.sum::<DVec3>().normalize_or_zero() * way.length();
        Some(Touch { way, side })
    }

    /// Returns the shortest way of the wrist that brings the arm out after it moved by `moved`,
    /// about: a point may be out once those before it are.
    fn way_out(&self, moved: DVec3) -> DVec3 {
        self.pairs().fold(DVec3::ZERO, |way, (capsule, (point, share))| {
            way + capsule.way_out(point + (moved + way) * share) / share
        })
    }

    /// Returns the way of the wrist in a direction that brings the arm out.
    fn exit(&self, direction: DVec3) -> DVec3 {
        let ways = self.pairs().map(|(capsule, (point, share))| {
            (0..STEPS).fold(0.0, |way, _| {
                way + capsule.way_out(point + direction * (way * share)).length() / share
            })
        });
        direction * ways.fold(0.0, f64::max).min(FURTHEST)
    }
}
