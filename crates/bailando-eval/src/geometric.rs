//! Geometric features (Müller et al. 2005): 32 yes-or-no questions about a pose, averaged over
//! time. METRICS.md, "Geometric features".

use glam::DVec3;

use crate::body::{JOINTS, Pose, joint::*};

/// Number of geometric features.
pub const GEOMETRIC_FEATURES: usize = 32;

/// Lengths that thresholds are multiples of, metres: humerus, shoulder width, hip width.
const HUMERUS: f64 = 0.256_838_1;
const SHOULDERS: f64 = 0.390_848_4;
const HIPS: f64 = 0.119_247_2;
/// Velocities are taken as if the motion had 120 frames a second: published so.
const VELOCITY_SCALE: f64 = 120.0;

/// The points that a question may be about: joints, and four that are none.
const ORIGIN: usize = JOINTS;
const UP: usize = JOINTS + 1;
const DOWN: usize = JOINTS + 2;
/// At the height of the lowest joint of the frame.
const GROUND: usize = JOINTS + 3;

/// A question about a pose and the one before it, with the threshold of a yes.
#[derive(Clone, Copy, Debug)]
enum Question {
    /// Does `c` move relative to `a` in the direction from `a` to `b`?
    Move(usize, usize, usize, f64),
    /// Does `d` move relative to `a` along the normal of the plane through `a`, `b`, `c`?
    NormalMove(usize, usize, usize, usize, f64),
    /// Does `p` lie beyond the plane through `a`, `b`, `c`?
    Plane(usize, usize, usize, usize, f64),
    /// Does `p` lie beyond the plane through `a` whose normal goes from `m` to `n`?
    NormalPlane(usize, usize, usize, usize, f64),
    /// Is the angle between `a -> b` and `c -> d` between two values in degrees?
    Angle(usize, usize, usize, usize, f64, f64),
    /// Does a joint move fast?
    Fast(usize, f64),
}

use Question::{Angle, Fast, Move, NormalMove, NormalPlane, Plane};

const QUESTIONS: [Question; GEOMETRIC_FEATURES] = [
    NormalMove(NECK, R_HIP, L_HIP, R_WRIST, 1.8 * HUMERUS),
    NormalMove(NECK, L_HIP, R_HIP, L_WRIST, 1.8 * HUMERUS),
    NormalPlane(CHEST, NECK, NECK, R_WRIST, 0.2 * HUMERUS),
    NormalPlane(CHEST, NECK, NECK, L_WRIST, 0.2 * HUMERUS),
    Move(BELLY, CHEST, CHEST, 1.8 * HUMERUS),
    // Twice the same: the original ignores the joint that would distinguish left and right.
    Move(BELLY, CHEST, CHEST, 1.8 * HUMERUS),
    Angle(R_ELBOW, R_SHOULDER, R_ELBOW, R_WRIST, 0.0, 110.0),
    Angle(L_ELBOW, L_SHOULDER, L_ELBOW, L_WRIST, 0.0, 110.0),
    NormalPlane(L_SHOULDER, R_SHOULDER, L_WRIST, R_WRIST, 2.5 * SHOULDERS),
    Move(L_WRIST, R_WRIST, R_WRIST, 1.4 * HUMERUS),
    Move(R_WRIST, ROOT, L_WRIST, 1.4 * HUMERUS),
    Move(L_WRIST, ROOT, R_WRIST, 1.4 * HUMERUS),
    Fast(R_WRIST, 2.5 * HUMERUS),
    Fast(L_WRIST, 2.5 * HUMERUS),
    Plane(ROOT, L_HIP, L_TOES, R_ANKLE, 0.38 * HUMERUS),
    Plane(ROOT, R_HIP, R_TOES, L_ANKLE, 0.38 * HUMERUS),
    NormalPlane(ORIGIN, UP, GROUND, R_ANKLE, 1.2 * HUMERUS),
    NormalPlane(ORIGIN, UP, GROUND, L_ANKLE, 1.2 * HUMERUS),
    NormalPlane(L_HIP, R_HIP, L_ANKLE, R_ANKLE, 2.1 * HIPS),
    Angle(R_KNEE, R_HIP, R_KNEE, R_ANKLE, 0.0, 110.0),
    Angle(L_KNEE, L_HIP, L_KNEE, L_ANKLE, 0.0, 110.0),
    Fast(R_ANKLE, 2.5 * HUMERUS),
    Fast(L_ANKLE, 2.5 * HUMERUS),
    Angle(NECK, ROOT, R_SHOULDER, R_ELBOW, 25.0, 180.0),
    Angle(NECK, ROOT, L_SHOULDER, L_ELBOW, 25.0, 180.0),
    Angle(NECK, ROOT, R_HIP, R_KNEE, 50.0, 180.0),
    Angle(NECK, ROOT, L_HIP, L_KNEE, 50.0, 180.0),
    Plane(R_ANKLE, NECK, L_ANKLE, ROOT, 0.5 * HUMERUS),
    Angle(NECK, ROOT, ORIGIN, UP, 70.0, 110.0),
    NormalPlane(ORIGIN, DOWN, GROUND, R_WRIST, -1.2 * HUMERUS),
    NormalPlane(ORIGIN, DOWN, GROUND, L_WRIST, -1.2 * HUMERUS),
    Fast(ROOT, 2.3 * HUMERUS),
];

/// Computes the 32 features of a clip: the share of frames, from the second on, with a yes.
#[must_use]
pub fn geometric_features(clip: &[Pose]) -> [f64; GEOMETRIC_FEATURES] {
    let mut counts = [0_u32; GEOMETRIC_FEATURES];
    for (before, now) in clip.iter().zip(clip.iter().skip(1)) {
        let frame = Frame::new(before, now);
        for (count, question) in counts.iter_mut().zip(&QUESTIONS) {
            *count += u32::from(frame.answer(question));
        }
    }
    let frames = clip.len().saturating_sub(1).max(1) as f64;
    counts.map(|count| f64::from(count) / frames)
}

struct Frame<'a> {
    before: &'a Pose,
    now: &'a Pose,
    lowest: f64,
}

impl<'a> Frame<'a> {
    fn new(before: &'a Pose, now: &'a Pose) -> Self {
        let heights = now.iter().map(|place| place.y);
        Self { before, now, lowest: heights.fold(f64::INFINITY, f64::min) }
    }

    fn place(&self, point: usize) -> DVec3 {
        match point {
            ORIGIN => DVec3::ZERO,
            UP => DVec3::Y,
            DOWN => DVec3::NEG_Y,
            GROUND => DVec3::Y * self.lowest,
            joint => self.now[joint],
        }
    }

    /// The way from one point to another.
    fn way(&self, from: usize, to: usize) -> DVec3 {
        self.place(to) - self.place(from)
    }

    /// Velocity of a joint relative to another.
    fn velocity(&self, joint: usize, relative_to: usize) -> DVec3 {
        (self.way(relative_to, joint) - (self.before[joint] - self.before[relative_to]))
            * VELOCITY_SCALE
    }

    fn normal(&self, a: usize, b: usize, c: usize) -> DVec3 {
        self.way(a, c).cross(self.way(a, b))
    }

    /// Where a direction has no length the answer is no, as NaN is above nothing.
    fn answer(&self, question: &Question) -> bool {
        match *question {
            Move(a, b, c, above) => along(self.velocity(c, a), self.way(a, b)) > above,
            NormalMove(a, b, c, d, above) => {
                along(self.velocity(d, a), self.normal(a, b, c)) > above
            }
            Plane(a, b, c, p, above) => along(self.way(a, p), self.normal(a, b, c)) > above,
            NormalPlane(m, n, a, p, above) => along(self.way(a, p), self.way(m, n)) > above,
            Angle(a, b, c, d, low, high) => {
                let one = self.way(a, b);
                let cosine = along(one, self.way(c, d)) / one.length();
                let angle = cosine.clamp(-1.0, 1.0).acos().to_degrees();
                low < angle && angle < high
            }
            Fast(joint, above) => {
                (self.now[joint] - self.before[joint]).length() * VELOCITY_SCALE > above
            }
        }
    }
}

/// The part of `vector` in a direction of any length.
fn along(vector: DVec3, direction: DVec3) -> f64 {
    vector.dot(direction) / direction.length()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body that stands upright, arms hanging and legs straight.
    fn standing() -> Pose {
        let mut pose = [DVec3::new(0.0, 0.9, 0.0); JOINTS];
        let mut put = |joint: usize, x: f64, y: f64, z: f64| pose[joint] = DVec3::new(x, y, z);
        put(BELLY, 0.0, 1.0, 0.0);
        put(CHEST, 0.0, 1.2, 0.0);
        put(NECK, 0.0, 1.4, 0.0);
        let left = [L_HIP, L_KNEE, L_ANKLE, L_TOES, L_SHOULDER, L_ELBOW, L_WRIST];
        let right = [R_HIP, R_KNEE, R_ANKLE, R_TOES, R_SHOULDER, R_ELBOW, R_WRIST];
        for (side, joints) in [(1.0, left), (-1.0, right)] {
            let [hip, knee, ankle, toes, shoulder, elbow, wrist] = joints;
            put(hip, side * 0.06, 0.85, 0.0);
            put(knee, side * 0.06, 0.48, 0.0);
            put(ankle, side * 0.06, 0.08, 0.0);
            put(toes, side * 0.06, 0.02, 0.12);
            put(shoulder, side * 0.19, 1.38, 0.0);
            put(elbow, side * 0.19, 1.12, 0.0);
            put(wrist, side * 0.19, 0.86, 0.0);
        }
        pose
    }

    /// The questions that are answered with yes when one pose follows another.
    fn yes(before: &Pose, now: &Pose) -> Vec<usize> {
        let features = geometric_features(&[*before, *now]);
        (0..GEOMETRIC_FEATURES).filter(|&at| features[at] > 0.5).collect()
    }

    /// The one yes of standing still: the normals of 14 and 15 are no mirror images of each other,
    /// so that one of the ankles is beyond its plane.
    const STANDING: usize = 15;

    #[test]
    fn standing_still_answers_yes_to_little() {
        let pose = standing();
        assert_eq!(yes(&pose, &pose), [STANDING]);
        // 29 and 30 ask whether the hands are less than 1.2 humeri above the ground.
        let mut low = pose;
        low[R_WRIST].y = 0.2;
        assert_eq!(yes(&low, &low), [STANDING, 29]);
    }

    #[test]
    fn raised_hands_are_beyond_the_neck() {
        let mut pose = standing();
        pose[L_WRIST] = DVec3::new(0.19, 1.4 + 0.21 * HUMERUS, 0.2);
        // The elbow is bent by more than 70 degrees as well.
        assert_eq!(yes(&pose, &pose), [3, 7, STANDING]);
        pose[L_WRIST].y = 1.4 + 0.19 * HUMERUS;
        assert_eq!(yes(&pose, &pose), [7, STANDING]);
    }

    #[test]
    fn raised_bent_and_crossed_legs_are_distinguished() {
        let mut pose = standing();
        // Left thigh forward, shank hanging: hip angle 90 degrees, knee angle 90.
        pose[L_KNEE] = pose[L_HIP] + DVec3::Z * 0.38;
        pose[L_ANKLE] = pose[L_KNEE] - DVec3::Y * 0.4;
        pose[L_TOES] = pose[L_ANKLE] + DVec3::new(0.0, -0.06, 0.12);
        let answers = yes(&pose, &pose);
        let has = |question| answers.contains(question);
        assert!([17, 20, 26].iter().all(has), "{answers:?}");
        assert!(![16, 19, 25].iter().any(has), "{answers:?}");
        let mut wide = standing();
        wide[R_ANKLE].x = wide[L_ANKLE].x - 2.2 * HIPS;
        assert!(yes(&wide, &wide).contains(&18));
    }

    #[test]
    fn speeds_count_as_if_there_were_120_frames_a_second() {
        let before = standing();
        let moved = |joint: usize, humeri: DVec3| {
            let mut now = before;
            now[joint] += humeri * HUMERUS / 120.0;
            yes(&before, &now)
        };
        assert!(moved(L_WRIST, DVec3::X * 2.51).contains(&13));
        assert!(!moved(L_WRIST, DVec3::X * 2.49).contains(&13));
        assert_eq!(moved(CHEST, DVec3::Y * 1.81), [4, 5, STANDING]);
        assert_eq!(moved(CHEST, DVec3::Y * 1.79), [STANDING]);
        // To one side of the plane through neck and hips only.
        let forward = moved(R_WRIST, DVec3::Z * 1.81).contains(&0);
        assert!(forward != moved(R_WRIST, DVec3::NEG_Z * 1.81).contains(&0));
    }

    #[test]
    fn lying_down_turns_the_spine_level() {
        let mut pose = standing();
        for place in &mut pose {
            *place = DVec3::new(place.x, 0.1, place.y);
        }
        assert!(yes(&pose, &pose).contains(&28));
    }

    #[test]
    fn features_are_shares_of_the_frames_after_the_first() {
        let standing = standing();
        let mut low = standing;
        low[R_WRIST].y = 0.2;
        let features = geometric_features(&[low, low, standing, standing, low]);
        assert!((features[29] - 0.5).abs() < 1e-12);
    }
}
