//! The end of a motion, from which another one continues.

use std::{
    f32::consts::{PI, TAU},
    str::FromStr,
};

use bailando_motion::Seam;
use base64::{Engine, engine::general_purpose::URL_SAFE_NO_PAD};
use glam::{Quat, Vec3};

use crate::{codes::Codes, error::FormatError};

/// Layout of the text form.
const VERSION: u8 = 2;
/// Bytes of the model's SHA-256 in the text: enough to notice another model.
const MODEL: usize = 4;
/// Most joints of a pose in the text, so that it fits into the value of an option.
const MOST_JOINTS: usize = 32;
/// Largest distance of a position from the origin, metres: no motion gets there, and single
/// precision still resolves millimetres.
const FURTHEST: f32 = 10_000.0;
/// Largest velocity of the root (m/s) and of a joint about each axis (radians a second) in the
/// text.
const FASTEST: f32 = 30.0 * PI;

/// The end of a motion: what the next one must know to continue from it (`continue_from`).
#[derive(Clone, Debug, PartialEq)]
pub struct Continuation {
    /// First bytes of the model's identity.
    model: [u8; MODEL],
    /// The last pose codes, at least one pair.
    pub codes: Codes,
    /// Position of the root in the next frame, x and z in metres.
    pub position: [f32; 2],
    /// Heading of the next pose, in radians about +y from +z.
    pub heading: f32,
    /// Frames of the last code that were shown, where the motion ended inside it; 0: all of them.
    pub shown: u8,
    /// Pose and speed of the next frame.
    pub seam: Option<Seam>,
}

impl Continuation {
    /// Describes the end of a motion of the model with this SHA-256 of its manifest, in
    /// hexadecimal.
    #[must_use]
    pub fn new(model_sha256: &str, codes: Codes, position: [f32; 2], heading: f32) -> Self {
        let model = identity(model_sha256);
        Self { model, codes, position, heading, shown: 0, seam: None }
    }

    /// With the pose and speed of the next frame, as far as a text can hold them.
    #[must_use]
    pub fn with_seam(self, seam: Option<Seam>) -> Self {
        let before = self.clone();
        let with = Self { seam, ..self };
        if with.is_readable() { with } else { before }
    }

    /// Whether the motion was the same model's.
    #[must_use]
    pub fn is_of(&self, model_sha256: &str) -> bool {
        self.model == identity(model_sha256)
    }

    /// Whether its text can be read again: a motion that went too far has no continuation.
    #[must_use]
    pub fn is_readable(&self) -> bool {
        Self::read(&self.to_text()).is_some()
    }

    /// Writes a text that is safe in a URL.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut bytes = vec![VERSION];
        bytes.extend(self.model);
        bytes.push(self.shown);
        for number in [self.heading, self.position[0], self.position[1]] {
            bytes.extend(number.to_le_bytes());
        }
        match &self.seam {
            None => bytes.push(0),
            Some(seam) => write_seam(seam, &mut bytes),
        }
        for (&upper, &lower) in self.codes.upper.iter().zip(&self.codes.lower) {
            for code in [upper, lower] {
                // A motion with larger codes has no continuation.
                bytes.extend(u16::try_from(code).unwrap_or(u16::MAX).to_le_bytes());
            }
        }
        URL_SAFE_NO_PAD.encode(bytes)
    }

    /// Reads [`Continuation::to_text`]; `None` for any other text.
    fn read(text: &str) -> Option<Self> {
        let bytes = URL_SAFE_NO_PAD.decode(text).ok()?;
        let mut rest = Reader(&bytes);
        if rest.byte()? != VERSION {
            return None;
        }
        let model = rest.take::<MODEL>()?;
        let shown = rest.byte()?;
        let heading = rest.float(TAU)?;
        let position = [rest.float(FURTHEST)?, rest.float(FURTHEST)?];
        let seam = match usize::from(rest.byte()?) {
            0 => None,
            joints if joints <= MOST_JOINTS => Some(read_seam(&mut rest, joints)?),
            _ => return None,
        };
        let (pairs, rest) = rest.0.as_chunks::<4>();
        if pairs.is_empty() || !rest.is_empty() {
            return None;
        }
        let code = |low, high| u32::from(u16::from_le_bytes([low, high]));
        let (upper, lower) = pairs.iter().map(|&[a, b, c, d]| (code(a, b), code(c, d))).unzip();
        Some(Self { model, codes: Codes { upper, lower }, position, heading, shown, seam })
    }
}

/// Writes the number of joints, the root, and for each joint the vector part of its rotation and
/// its angular velocity in sixteen bits.
fn write_seam(seam: &Seam, bytes: &mut Vec<u8>) {
    // A pose with more joints than a text can hold makes one that cannot be read.
    bytes.push(u8::try_from(seam.rotations.len()).unwrap_or(u8::MAX));
    for vector in [seam.root, seam.velocity] {
        bytes.extend(vector.to_array().into_iter().flat_map(f32::to_le_bytes));
    }
    let mut write = |vector: Vec3, most: f32| {
        for number in vector.to_array() {
            let share = (number / most).clamp(-1.0, 1.0) * f32::from(i16::MAX);
            bytes.extend((share.round() as i16).to_le_bytes());
        }
    };
    for (&rotation, &spin) in seam.rotations.iter().zip(&seam.spins) {
        let rotation = if rotation.w < 0.0 { -rotation } else { rotation };
        write(rotation.xyz(), 1.0);
        write(spin, FASTEST);
    }
}

fn read_seam(rest: &mut Reader<'_>, joints: usize) -> Option<Seam> {
    let root = rest.vector(|rest| rest.float(FURTHEST))?;
    let velocity = rest.vector(|rest| rest.float(FASTEST))?;
    let mut seam = Seam { root, velocity, rotations: Vec::new(), spins: Vec::new() };
    for _ in 0..joints {
        let xyz = rest.vector(|rest| rest.share(1.0))?;
        let w = (1.0 - xyz.length_squared()).max(0.0).sqrt();
        seam.rotations.push(Quat::from_vec4(xyz.extend(w)).normalize());
        seam.spins.push(rest.vector(|rest| rest.share(FASTEST))?);
    }
    Some(seam)
}

/// Bytes that are not read yet.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*taken)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take::<1>().map(|[byte]| byte)
    }

    fn float(&mut self, most: f32) -> Option<f32> {
        let number = f32::from_le_bytes(self.take()?);
        (-most..=most).contains(&number).then_some(number)
    }

    /// A number in sixteen bits, of which the largest means `most`.
    fn share(&mut self, most: f32) -> Option<f32> {
        let share = i16::from_le_bytes(self.take()?);
        Some(f32::from(share) / f32::from(i16::MAX) * most)
    }

    fn vector(&mut self, read: impl Fn(&mut Self) -> Option<f32>) -> Option<Vec3> {
        Some(Vec3::new(read(self)?, read(self)?, read(self)?))
    }
}

impl FromStr for Continuation {
    type Err = FormatError;

    fn from_str(text: &str) -> Result<Self, FormatError> {
        Self::read(text).ok_or(FormatError::Continuation)
    }
}

/// Returns the first bytes of a text of hexadecimal digits.
fn identity(sha256: &str) -> [u8; MODEL] {
    let mut bytes = [0; MODEL];
    for (byte, digits) in bytes.iter_mut().zip(sha256.as_bytes().chunks(2)) {
        let digits = std::str::from_utf8(digits).unwrap_or_default();
        *byte = u8::from_str_radix(digits, 16).unwrap_or_default();
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: &str = "0123456789abcdef";

    fn continuation(pairs: u32) -> Continuation {
        let codes = Codes {
            upper: (0..pairs).collect(),
            lower: (0..pairs).map(|code| 511 - code).collect(),
        };
        Continuation::new(MODEL, codes, [1.5, -2.25], 0.75)
    }

    #[test]
    fn it_is_read_as_it_was_written_and_knows_its_model() {
        let continuation = continuation(26);
        let text = continuation.to_text();
        assert_eq!(text.parse::<Continuation>().unwrap(), continuation);
        assert!(continuation.is_of(MODEL) && continuation.is_readable());
        let position = [FURTHEST + 1.0, 0.0];
        assert!(!Continuation { position, ..continuation.clone() }.is_readable());
        assert!(!continuation.is_of("fedcba98"));
    }

    #[test]
    fn a_pose_and_its_speed_come_back_within_sixteen_bits() {
        let turn = |joint: usize, by: f32| Vec3::new(1.0, -0.5, 0.2 * joint as f32) * by;
        let joints = 0..24;
        let seam = Seam {
            root: Vec3::new(1.0, 0.96, -3.0),
            velocity: Vec3::new(0.5, -0.1, 2.0),
            rotations: joints.clone().map(|j| -Quat::from_scaled_axis(turn(j, 0.3))).collect(),
            spins: joints.map(|joint| turn(joint, 4.0)).collect(),
        };
        let before = Continuation { shown: 5, ..continuation(43) }.with_seam(Some(seam.clone()));
        let text = before.to_text();
        assert!(text.len() <= 1024, "{}", text.len());
        let after: Continuation = text.parse().unwrap();
        assert_eq!((after.shown, &after.codes), (5, &before.codes));
        let found = after.seam.unwrap();
        assert_eq!((found.root, found.velocity), (seam.root, seam.velocity));
        for (a, b) in found.rotations.iter().zip(&seam.rotations) {
            assert!(a.dot(*b).abs() > 1.0 - 1e-6);
        }
        for (a, b) in found.spins.iter().zip(&seam.spins) {
            assert!((*a - *b).length() < 5e-3);
        }
        // What a text cannot hold is left out.
        let rotations = vec![Quat::IDENTITY; 60];
        let many = Seam { spins: vec![Vec3::ZERO; 60], rotations, ..seam.clone() };
        assert_eq!(continuation(2).with_seam(Some(many)), continuation(2));
        let far = Seam { root: Vec3::X * 2.0 * FURTHEST, ..seam };
        assert_eq!(continuation(2).with_seam(Some(far)), continuation(2));
    }

    #[test]
    fn other_texts_are_refused() {
        let text = continuation(2).to_text();
        let odd = |position, heading| {
            let continuation = continuation(1);
            Continuation { position, heading, ..continuation }.to_text()
        };
        let texts = [
            String::new(),
            "x".into(),
            "AAAA".into(),
            "%%%%".into(),
            text[..text.len() - 3].into(),
            continuation(0).to_text(),
            odd([f32::NAN, 0.0], 0.75),
            odd([0.0, 1e30], 0.75),
            odd([1.5, -2.25], 100.0),
        ];
        for text in texts {
            assert!(text.parse::<Continuation>().is_err(), "{text}");
        }
    }
}
