//! Contacts of one point of a sole with the floor, and where they hold it.

use glam::DVec3;

use super::foot::height;
use crate::{
    floor::STANDING_HEIGHT,
    smooth::{hermite, smooth_step},
};

/// When a point stands on the floor. A contact begins below the first of each pair and ends above
/// the second.
#[derive(Clone, Copy, Debug)]
pub(super) struct Thresholds {
    /// Metres above the place where it stands.
    height: (f64, f64),
    /// Speed along the floor, metres a second.
    speed: (f64, f64),
    /// A contact ends where its point has come this far across the floor, metres.
    furthest: f64,
}

/// Of a ball. Recorded dancers' stand 1.5 cm high with the heel down and up to 4 cm when they
/// pivot; a step is over a metre a second, while decoded feet that should stand slide by 0.2 on
/// average.
pub(super) const BALL: Thresholds =
    Thresholds { height: (0.035, 0.055), speed: (0.45, 0.75), furthest: 0.12 };
/// Of a heel, which turns about the ball in every pivot.
pub(super) const HEEL: Thresholds =
    Thresholds { height: (0.03, 0.05), speed: (0.3, 0.5), furthest: 0.07 };
/// A point that another motion left higher than this, metres, is on its way to the floor.
const STANDING: f64 = 0.005;
/// Frames on either side of one between which its speed is measured, seconds.
const SPEED_SPAN: f64 = 0.034;
/// Shortest contact, and shortest time between one that went too far and the next, seconds.
const SHORTEST: f64 = 0.08;
/// Seconds of a contact that are known when its place is chosen.
const SHOWN: f64 = 0.25;
/// Seconds over which a point comes to a contact's place and leaves it.
const BLEND: f64 = 0.2;

/// The contacts of one point along a motion.
#[derive(Clone, Debug)]
pub(super) struct Contacts {
    thresholds: Thresholds,
    places: Vec<DVec3>,
    all: Vec<Contact>,
    /// Frames for which there is a decision.
    decided: usize,
    /// First frame that may begin a contact.
    free_from: usize,
    /// Smallest and largest x and z of the open contact.
    spread: [DVec3; 2],
    blend: usize,
    span: usize,
    shortest: usize,
    shown: usize,
    seconds: f64,
    continues: bool,
}

#[derive(Clone, Copy, Debug)]
struct Contact {
    start: usize,
    /// The frame after the last; none while it lasts.
    end: Option<usize>,
    anchor: Option<DVec3>,
}

/// What contacts do to a point in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hold {
    /// How far the point moves, metres.
    pub(super) offset: DVec3,
    /// 1 in contact, 0 well away from one, smooth between.
    pub(super) weight: f64,
}

impl Contacts {
    /// `continues`: the motion begins where another one left the foot.
    pub(super) fn new(thresholds: &Thresholds, fps: u32, continues: bool) -> Self {
        let fps = f64::from(fps.max(1));
        let frames = |seconds: f64| ((seconds * fps).round() as usize).max(1);
        Self {
            thresholds: *thresholds,
            places: Vec::new(),
            all: Vec::new(),
            decided: 0,
            free_from: 0,
            spread: [DVec3::ZERO; 2],
            blend: frames(BLEND),
            span: frames(SPEED_SPAN),
            shortest: frames(SHORTEST),
            shown: frames(SHOWN),
            seconds: 1.0 / fps,
            continues,
        }
    }

    /// Frames that must be known after the one that [`Contacts::at`] is asked for.
    pub(super) fn lookahead(&self) -> usize {
        2 * self.blend + self.span + self.shown
    }

    /// Takes the point's place in the next frame, metres.
    pub(super) fn push(&mut self, place: DVec3) {
        self.places.push(place);
        if self.places.len() > self.span {
            self.decide();
        }
    }

    /// Decides the last frames.
    pub(super) fn end(&mut self) {
        while self.decided < self.places.len() {
            self.decide();
        }
        self.close(self.decided);
    }

    /// Returns the point's speed along the floor around a frame, metres a second.
    fn speed(&self, frame: usize) -> f64 {
        let (first, last) = (frame.saturating_sub(self.span), frame + self.span);
        let last = last.min(self.places.len() - 1);
        let step = self.places[last] - self.places[first];
        step.x.hypot(step.z) / ((last - first).max(1) as f64 * self.seconds)
    }

    fn decide(&mut self) {
        let frame = self.decided;
        self.decided += 1;
        if self.continues && frame == 0 && height(self.places[0]) > STANDING {
            self.free_from = self.blend;
        }
        let (place, speed) = (self.places[frame], self.speed(frame));
        let Thresholds { height: heights, speed: speeds, furthest } = self.thresholds;
        if self.all.last().is_some_and(|contact| contact.end.is_none()) {
            let [low, high] = self.spread;
            self.spread = [low.min(place), high.max(place)];
            let across = self.spread[1] - self.spread[0];
            let too_far = across.x.hypot(across.z) > furthest;
            if too_far {
                self.free_from = frame + self.shortest;
            }
            if too_far || height(place) > heights.1 || speed > speeds.1 {
                self.close(frame);
            }
        } else if frame >= self.free_from && height(place) < heights.0 && speed < speeds.0 {
            self.all.push(Contact { start: frame, end: None, anchor: None });
            self.spread = [place; 2];
        }
    }

    /// Ends the open contact, and forgets it if it was short.
    fn close(&mut self, end: usize) {
        let Some(open) = self.all.last_mut().filter(|contact| contact.end.is_none()) else {
            return;
        };
        open.end = Some(end);
        if end - open.start < self.shortest {
            self.all.pop();
        }
    }

    /// Returns what contacts do in `frame`.
    pub(super) fn at(&mut self, frame: usize) -> Hold {
        let begun = self.all.partition_point(|contact| contact.start <= frame);
        let before = begun.checked_sub(1);
        if let Some(index) = before.filter(|&index| self.holds(index, frame)) {
            return Hold { offset: self.offset(index, frame), weight: 1.0 };
        }
        // The frames from the last one of the contact before, and to the first one of the next.
        let left = before.map(|index| {
            let last = self.all[index].end.unwrap_or(frame) - 1;
            (frame - last, self.edge(index, last, true))
        });
        let coming = (begun < self.all.len()).then_some(begun);
        let right = coming.map(|index| {
            let start = self.all[index].start;
            (start - frame, self.edge(index, start, false))
        });
        let blend = self.blend;
        let left = left.filter(|&(frames, _)| frames < 2 * blend);
        let right = right.filter(|&(frames, _)| frames < 2 * blend);
        let weight = |frames: usize| smooth_step(1.0 - frames as f64 / blend as f64);
        let weights = [left, right].map(|side| side.map_or(0.0, |(frames, _)| weight(frames)));
        let offset = match (left, right) {
            (Some((since, from)), Some((until, to))) if since + until < 2 * blend => {
                hermite(from, to, since as f64, (since + until) as f64)
            }
            _ => {
                let still = (DVec3::ZERO, DVec3::ZERO);
                let length = blend as f64;
                let part = |side: Option<(usize, _)>| match side {
                    Some((frames, edge)) if frames < blend => {
                        hermite(edge, still, frames as f64, length)
                    }
                    _ => DVec3::ZERO,
                };
                // Backwards in time to the contact that comes.
                let backwards = right.map(|(frames, (offset, rate))| (frames, (offset, -rate)));
                part(left) + part(backwards)
            }
        };
        Hold { offset, weight: weights[0].max(weights[1]) }
    }

    fn holds(&self, index: usize, frame: usize) -> bool {
        let contact = self.all[index];
        contact.start <= frame && contact.end.is_none_or(|end| frame < end)
    }

    fn offset(&mut self, index: usize, frame: usize) -> DVec3 {
        self.anchor(index) - self.places[frame]
    }

    /// Returns offset and its change a frame at the edge of a contact.
    fn edge(&mut self, index: usize, frame: usize, is_end: bool) -> (DVec3, DVec3) {
        let other = match is_end {
            true => frame.saturating_sub(1),
            false => (frame + 1).min(self.places.len() - 1),
        };
        let step = (self.places[frame] - self.places[other]) * if is_end { -1.0 } else { 1.0 };
        (self.offset(index, frame), step)
    }

    /// Returns where a contact holds the point: in the middle of where it was as far as is known
    /// when that is first asked for, or where another motion left it.
    fn anchor(&mut self, index: usize) -> DVec3 {
        let Contact { start, end, anchor } = self.all[index];
        anchor.unwrap_or_else(|| {
            let places = &self.places[start..end.unwrap_or(self.decided)];
            let middle = match self.continues && start == 0 {
                true => places[0],
                false => places.iter().sum::<DVec3>() / places.len() as f64,
            };
            let anchor = middle.with_y(f64::from(STANDING_HEIGHT));
            self.all[index].anchor = Some(anchor);
            anchor
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A foot that swings for half a second, slides on the floor for a second at `slide` m/s, and
    /// swings again.
    fn step(slide: f64) -> Vec<DVec3> {
        let mut place = DVec3::new(0.0, 0.2, 0.0);
        let mut places = Vec::new();
        for frame in 0..120 {
            let stands = (30..90).contains(&frame);
            place.x += if stands { slide } else { 1.5 } / 60.0;
            let from_floor = f64::from(30_i32.saturating_sub(frame).max(frame - 89).max(0));
            place.y = 0.02 + 0.15 * (from_floor / 30.0).powi(2);
            places.push(place);
        }
        places
    }

    fn holds(places: &[DVec3], continues: bool) -> Vec<Hold> {
        let mut contacts = Contacts::new(&BALL, 60, continues);
        let mut holds = Vec::new();
        for &place in places {
            contacts.push(place);
            while contacts.places.len() > holds.len() + contacts.lookahead() {
                holds.push(contacts.at(holds.len()));
            }
        }
        contacts.end();
        (holds.len()..places.len()).for_each(|frame| holds.push(contacts.at(frame)));
        holds
    }

    #[test]
    fn a_sliding_foot_stands_still_and_comes_and_goes_without_a_jump() {
        let places = step(0.1);
        let holds = holds(&places, false);
        let path: Vec<DVec3> =
            places.iter().zip(&holds).map(|(p, hold)| *p + hold.offset).collect();
        let standing: Vec<DVec3> = path
            .iter()
            .zip(&holds)
            .filter(|(_, hold)| hold.weight == 1.0)
            .map(|(p, _)| *p)
            .collect();
        assert!(standing.len() > 50);
        for place in &standing {
            assert!((*place - standing[0]).length() < 1e-12);
            assert_eq!(height(*place), 0.0);
        }
        // Held in the middle of what is known of its slide.
        let slid = standing[0].x - places[30].x;
        assert!(slid > 0.5 * 0.1 * SHOWN - 0.01 && slid < 0.05, "{slid}");
        for (before, after) in path.windows(3).zip(places.windows(3)) {
            let jerk = |three: &[DVec3]| (three[2] - 2.0 * three[1] + three[0]).length();
            assert!(jerk(before) < jerk(after) + 0.004);
        }
        assert_eq!(holds[0], Hold { offset: DVec3::ZERO, weight: 0.0 });
    }

    #[test]
    fn steps_and_short_touches_are_no_contacts() {
        let fast = step(1.0);
        assert!(holds(&fast, false).iter().all(|hold| hold.weight == 0.0));
        let mut touch = vec![DVec3::Y * 0.2; 60];
        touch[30..33].fill(DVec3::Y * 0.02);
        assert!(holds(&touch, false).iter().all(|hold| hold.offset == DVec3::ZERO));
    }

    #[test]
    fn a_point_that_wanders_off_is_let_go() {
        let wandering: Vec<DVec3> =
            (0..240).map(|frame| DVec3::new(0.2 * f64::from(frame) / 60.0, 0.02, 0.0)).collect();
        for hold in holds(&wandering, false) {
            assert!(hold.offset.with_y(0.0).length() < BALL.furthest, "{hold:?}");
        }
    }

    #[test]
    fn a_motion_that_continues_another_holds_the_foot_where_it_was() {
        let sliding: Vec<DVec3> =
            (0..40).map(|frame| DVec3::new(0.1 * f64::from(frame) / 60.0, 0.015, 0.0)).collect();
        assert!(holds(&sliding, true)[0].offset.length() < 1e-6);
        assert!(holds(&sliding, false)[0].offset.length() > 0.01);
        // One that is still on its way down comes down first.
        let above: Vec<DVec3> = sliding.iter().map(|place| *place + DVec3::Y * 0.01).collect();
        assert!(holds(&above, true)[0].weight < 0.1);
    }
}
