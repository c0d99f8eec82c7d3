//! The end of a motion, from which another one continues.

use std::{f32::consts::TAU, str::FromStr};

use base64::{Engine, engine::general_purpose::URL_SAFE_NO_PAD};

use crate::{codes::Codes, error::FormatError};

/// Layout of the text form.
const VERSION: u8 = 1;
/// Bytes before the codes: version, model, heading, position.
const HEAD: usize = 1 + MODEL + 3 * 4;
/// Bytes of the model's SHA-256 in the text: enough to notice another model.
const MODEL: usize = 4;

/// Largest distance of a position from the origin, metres: no motion gets there, and single
/// precision still resolves millimetres.
const FURTHEST: f32 = 10_000.0;

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
}

impl Continuation {
    /// Describes the end of a motion of the model with this SHA-256 of its manifest, in
    /// hexadecimal.
    #[must_use]
    pub fn new(model_sha256: &str, codes: Codes, position: [f32; 2], heading: f32) -> Self {
        Self { model: identity(model_sha256), codes, position, heading }
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
        for number in [self.heading, self.position[0], self.position[1]] {
            bytes.extend(number.to_le_bytes());
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
        let (head, codes) = bytes.split_at_checked(HEAD)?;
        let (&version, head) = head.split_first()?;
        let (model, numbers) = head.split_first_chunk::<MODEL>()?;
        let (numbers, _) = numbers.as_chunks::<4>();
        let mut numbers = numbers.iter().map(|bytes| f32::from_le_bytes(*bytes));
        let mut within = |most: f32| {
            let number = numbers.next();
            number.filter(|number| (-most..=most).contains(number))
        };
        let (heading, x, z) = (within(TAU)?, within(FURTHEST)?, within(FURTHEST)?);
        let (pairs, rest) = codes.as_chunks::<4>();
        if version != VERSION || pairs.is_empty() || !rest.is_empty() {
            return None;
        }
        let code = |low, high| u32::from(u16::from_le_bytes([low, high]));
        let (upper, lower) = pairs.iter().map(|&[a, b, c, d]| (code(a, b), code(c, d))).unzip();
        Some(Self { model: *model, codes: Codes { upper, lower }, position: [x, z], heading })
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
        assert!(text.len() <= 256, "{}", text.len());
        assert_eq!(text.parse::<Continuation>().unwrap(), continuation);
        assert!(continuation.is_of(MODEL) && continuation.is_readable());
        let position = [FURTHEST + 1.0, 0.0];
        assert!(!Continuation { position, ..continuation.clone() }.is_readable());
        assert!(!continuation.is_of("fedcba98"));
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
