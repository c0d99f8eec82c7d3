//! Geometric features (Müller et al. 2005): 32 yes-or-no questions about a pose, averaged over
//! time. METRICS.md, "Geometric features".

use glam::DVec3;

use super::body::{Pose, joint::*};

/// Number of geometric features.
pub const GEOMETRIC_FEATURES: usize = 32;

/// Lengths that thresholds are multiples of, metres: humerus, shoulder width, hip width.
const HUMERUS: f64 = 0.256_838_1;
const SHOULDERS: f64 = 0.390_848_4;
const HIPS: f64 = 0.119_247_2;
/// Velocities are taken as if the motion had 120 frames a second: published so.
const VELOCITY_SCALE: f64 = 120.0;

/// A point that a question is about.
#[derive(Clone, Copy, Debug)]
enum Point {
    Joint(usize),
    Origin,
    Up,
    Down,
    /// At the height of the lowest joint of the frame.
    Ground,
}

use Point::{Down, Ground, Joint, Origin, Up};

/// A question about a pose and the one before it.
#[derive(Clone, Copy, Debug)]
enum Question {
    /// Does `c` move relative to `a` in the direction from `a` to `b`?
    Move(usize, usize, usize, f64),
    /// Does `d` move relative to `a` along the normal of the plane through `a`, `b`, `c`?
    NormalMove(usize, usize, usize, usize, f64),
    /// Does `p` lie beyond the plane through `a`, `b`, `c`?
    Plane(usize, usize, usize, usize, f64),
    /// Does `p` lie beyond the plane through `a` whose normal goes from `m` to `n`?
    NormalPlane(Point, Point, Point, usize, f64),
    /// Is the angle between `a -> b` and `c -> d` between two values in degrees?
    Angle(usize, usize, Point, Point, f64, f64),
    /// Does a joint move fast?
    Fast(usize, f64),
}

use Question::{Angle, Fast, Move, NormalMove, NormalPlane, Plane};

const QUESTIONS: [Question; GEOMETRIC_FEATURES] = [
    NormalMove(NECK, RIGHT_HIP, LEFT_HIP, RIGHT_WRIST, 1.8 * HUMERUS),
    NormalMove(NECK, LEFT_HIP, RIGHT_HIP, LEFT_WRIST, 1.8 * HUMERUS),
    NormalPlane(
        Joint(CHEST),
        Joint(NECK),
        Joint(NECK),
        RIGHT_WRIST,
        0.2 * HUMERUS,
    ),
    NormalPlane(
        Joint(CHEST),
        Joint(NECK),
        Joint(NECK),
        LEFT_WRIST,
        0.2 * HUMERUS,
    ),
    Move(BELLY, CHEST, CHEST, 1.8 * HUMERUS),
    // Twice the same: the joint that tells left from right is ignored by the original.
    Move(BELLY, CHEST, CHEST, 1.8 * HUMERUS),
    Angle(
        RIGHT_ELBOW,
        RIGHT_SHOULDER,
        Joint(RIGHT_ELBOW),
        Joint(RIGHT_WRIST),
        0.0,
        110.0,
    ),
    Angle(
        LEFT_ELBOW,
        LEFT_SHOULDER,
        Joint(LEFT_ELBOW),
        Joint(LEFT_WRIST),
        0.0,
        110.0,
    ),
    NormalPlane(
        Joint(LEFT_SHOULDER),
        Joint(RIGHT_SHOULDER),
        Joint(LEFT_WRIST),
        RIGHT_WRIST,
        2.5 * SHOULDERS,
    ),
    Move(LEFT_WRIST, RIGHT_WRIST, RIGHT_WRIST, 1.4 * HUMERUS),
    Move(RIGHT_WRIST, ROOT, LEFT_WRIST, 1.4 * HUMERUS),
    Move(LEFT_WRIST, ROOT, RIGHT_WRIST, 1.4 * HUMERUS),
    Fast(RIGHT_WRIST, 2.5 * HUMERUS),
    Fast(LEFT_WRIST, 2.5 * HUMERUS),
    Plane(ROOT, LEFT_HIP, LEFT_TOES, RIGHT_ANKLE, 0.38 * HUMERUS),
    Plane(ROOT, RIGHT_HIP, RIGHT_TOES, LEFT_ANKLE, 0.38 * HUMERUS),
    NormalPlane(Origin, Up, Ground, RIGHT_ANKLE, 1.2 * HUMERUS),
    NormalPlane(Origin, Up, Ground, LEFT_ANKLE, 1.2 * HUMERUS),
    NormalPlane(
        Joint(LEFT_HIP),
        Joint(RIGHT_HIP),
        Joint(LEFT_ANKLE),
        RIGHT_ANKLE,
        2.1 * HIPS,
    ),
    Angle(
        RIGHT_KNEE,
        RIGHT_HIP,
        Joint(RIGHT_KNEE),
        Joint(RIGHT_ANKLE),
        0.0,
        110.0,
    ),
    Angle(
        LEFT_KNEE,
        LEFT_HIP,
        Joint(LEFT_KNEE),
        Joint(LEFT_ANKLE),
        0.0,
        110.0,
    ),
    Fast(RIGHT_ANKLE, 2.5 * HUMERUS),
    Fast(LEFT_ANKLE, 2.5 * HUMERUS),
    Angle(
        NECK,
        ROOT,
        Joint(RIGHT_SHOULDER),
        Joint(RIGHT_ELBOW),
        25.0,
        180.0,
    ),
    Angle(
        NECK,
        ROOT,
        Joint(LEFT_SHOULDER),
        Joint(LEFT_ELBOW),
        25.0,
        180.0,
    ),
    Angle(NECK, ROOT, Joint(RIGHT_HIP), Joint(RIGHT_KNEE), 50.0, 180.0),
    Angle(NECK, ROOT, Joint(LEFT_HIP), Joint(LEFT_KNEE), 50.0, 180.0),
    Plane(RIGHT_ANKLE, NECK, LEFT_ANKLE, ROOT, 0.5 * HUMERUS),
    Angle(NECK, ROOT, Origin, Up, 70.0, 110.0),
    NormalPlane(Origin, Down, Ground, RIGHT_WRIST, -1.2 * HUMERUS),
    NormalPlane(Origin, Down, Ground, LEFT_WRIST, -1.2 * HUMERUS),
    Fast(ROOT, 2.3 * HUMERUS),
];

/// The 32 features of a clip: the share of frames, from the second on, with the answer yes.
#[must_use]
pub fn geometric_features(clip: &[Pose]) -> [f64; GEOMETRIC_FEATURES] {
    let mut counts = [0_u32; GEOMETRIC_FEATURES];
    for pair in clip.windows(2) {
        if let [before, now] = pair {
            let frame = Frame::new(before, now);
            for (count, question) in counts.iter_mut().zip(&QUESTIONS) {
                *count += u32::from(frame.answer(question));
            }
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
        let lowest = now
            .iter()
            .map(|place| place.y)
            .fold(f64::INFINITY, f64::min);
        Self {
            before,
            now,
            lowest,
        }
    }

    fn place(&self, point: Point) -> DVec3 {
        match point {
            Joint(joint) => self.now[joint],
            Origin => DVec3::ZERO,
            Up => DVec3::Y,
            Down => DVec3::NEG_Y,
            Ground => DVec3::Y * self.lowest,
        }
    }

    /// Velocity of a joint relative to another.
    fn velocity(&self, joint: usize, relative_to: usize) -> DVec3 {
        let now = self.now[joint] - self.now[relative_to];
        let before = self.before[joint] - self.before[relative_to];
        (now - before) * VELOCITY_SCALE
    }

    fn normal(&self, a: usize, b: usize, c: usize) -> DVec3 {
        (self.now[c] - self.now[a]).cross(self.now[b] - self.now[a])
    }

    /// Where a direction has no length the answer is no, as NaN is above nothing.
    fn answer(&self, question: &Question) -> bool {
        match *question {
            Move(a, b, c, above) => along(self.velocity(c, a), self.now[b] - self.now[a]) > above,
            NormalMove(a, b, c, d, above) => {
                along(self.velocity(d, a), self.normal(a, b, c)) > above
            }
            Plane(a, b, c, p, above) => {
                along(self.now[p] - self.now[a], self.normal(a, b, c)) > above
            }
            NormalPlane(m, n, a, p, above) => {
                let normal = self.place(n) - self.place(m);
                along(self.now[p] - self.place(a), normal) > above
            }
            Angle(a, b, c, d, low, high) => {
                let one = self.now[b] - self.now[a];
                let other = self.place(d) - self.place(c);
                let cosine = along(one, other) / one.length();
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
    use super::{super::body::JOINTS, *};

    /// Somebody who stands upright with the arms hanging and the legs straight.
    fn standing() -> Pose {
        let mut pose = [DVec3::new(0.0, 0.9, 0.0); JOINTS];
        let mut put = |joint: usize, x: f64, y: f64, z: f64| pose[joint] = DVec3::new(x, y, z);
        put(BELLY, 0.0, 1.0, 0.0);
        put(CHEST, 0.0, 1.2, 0.0);
        put(NECK, 0.0, 1.4, 0.0);
        let left = [
            LEFT_HIP,
            LEFT_KNEE,
            LEFT_ANKLE,
            LEFT_TOES,
            LEFT_SHOULDER,
            LEFT_ELBOW,
            LEFT_WRIST,
        ];
        let right = [
            RIGHT_HIP,
            RIGHT_KNEE,
            RIGHT_ANKLE,
            RIGHT_TOES,
            RIGHT_SHOULDER,
            RIGHT_ELBOW,
            RIGHT_WRIST,
        ];
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
        (0..GEOMETRIC_FEATURES)
            .filter(|&at| features[at] > 0.5)
            .collect()
    }

    /// What standing still answers yes to: the normals of 14 and 15 are no mirror images of each
    /// other, so that one of the ankles is beyond its plane.
    const STANDING: usize = 15;

    #[test]
    fn standing_still_answers_yes_to_little() {
        let pose = standing();
        assert_eq!(yes(&pose, &pose), [STANDING]);
        // 29 and 30 ask whether the hands are less than 1.2 humeri above the ground.
        let mut low = pose;
        low[RIGHT_WRIST].y = 0.2;
        assert_eq!(yes(&low, &low), [STANDING, 29]);
    }

    #[test]
    fn raised_hands_are_beyond_the_neck() {
        let mut pose = standing();
        pose[LEFT_WRIST] = DVec3::new(0.19, 1.4 + 0.21 * HUMERUS, 0.2);
        // The elbow is bent by more than 70 degrees as well.
        assert_eq!(yes(&pose, &pose), [3, 7, STANDING]);
        pose[LEFT_WRIST].y = 1.4 + 0.19 * HUMERUS;
        assert_eq!(yes(&pose, &pose), [7, STANDING]);
    }

    #[test]
    fn legs_raised_bent_and_crossed_are_told_apart() {
        let mut pose = standing();
        // Left thigh forward, shank hanging: hip angle 90 degrees, knee angle 90.
        pose[LEFT_KNEE] = pose[LEFT_HIP] + DVec3::Z * 0.38;
        pose[LEFT_ANKLE] = pose[LEFT_KNEE] - DVec3::Y * 0.4;
        pose[LEFT_TOES] = pose[LEFT_ANKLE] + DVec3::new(0.0, -0.06, 0.12);
        let answers = yes(&pose, &pose);
        assert!(
            [17, 20, 26]
                .iter()
                .all(|question| answers.contains(question)),
            "{answers:?}"
        );
        assert!(
            [16, 19, 25]
                .iter()
                .all(|question| !answers.contains(question)),
            "{answers:?}"
        );
        let mut wide = standing();
        wide[RIGHT_ANKLE].x = wide[LEFT_ANKLE].x - 2.2 * HIPS;
        assert!(yes(&wide, &wide).contains(&18));
    }

    #[test]
    fn speeds_count_as_if_there_were_120_frames_a_second() {
        let before = standing();
        let moved = |joint: usize, by: DVec3| {
            let mut now = before;
            now[joint] += by / 120.0;
            now
        };
        assert!(yes(&before, &moved(LEFT_WRIST, DVec3::X * 2.51 * HUMERUS)).contains(&13));
        assert!(!yes(&before, &moved(LEFT_WRIST, DVec3::X * 2.49 * HUMERUS)).contains(&13));
        assert_eq!(
            yes(&before, &moved(CHEST, DVec3::Y * 1.81 * HUMERUS)),
            [4, 5, STANDING]
        );
        assert_eq!(
            yes(&before, &moved(CHEST, DVec3::Y * 1.79 * HUMERUS)),
            [STANDING]
        );
        // Forward of the plane through neck and hips, which the hands approach from behind.
        let forward = yes(&before, &moved(RIGHT_WRIST, DVec3::Z * 1.81 * HUMERUS));
        assert!(
            forward.contains(&0)
                != yes(&before, &moved(RIGHT_WRIST, DVec3::NEG_Z * 1.81 * HUMERUS)).contains(&0)
        );
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
        low[RIGHT_WRIST].y = 0.2;
        let features = geometric_features(&[low, low, standing, standing, low]);
        assert!((features[29] - 0.5).abs() < 1e-12);
    }
}
