//! Where a dance ends, so that another one goes on from there.

use std::f32::consts::TAU;

use base64::{Engine, engine::general_purpose::URL_SAFE_NO_PAD};

use super::{Codes, FormatError};

/// Layout of the text form.
const VERSION: u8 = 1;
/// Bytes before the codes: version, model, facing, place.
const HEAD: usize = 1 + MODEL + 3 * 4;
/// Bytes of the model's SHA-256 that a tail carries: enough to tell models apart by mistake.
const MODEL: usize = 4;

/// Largest distance of a place from the start, metres: no dance gets there, and single precision still tells
/// millimetres.
const FURTHEST: f32 = 10_000.0;

/// The end of a dance: what the next one must know to go on from it (`continue_from`).
#[derive(Clone, Debug, PartialEq)]
pub struct Tail {
    /// First bytes of the model's identity.
    model: [u8; MODEL],
    /// The last pose codes, at least one pair.
    pub codes: Codes,
    /// Where the root goes next on the floor, x and z in metres.
    pub place: [f32; 2],
    /// Where the next pose faces, in radians about +y from +z.
    pub facing: f32,
}

impl Tail {
    /// The end of a dance of the model with this SHA-256 of its manifest, in hexadecimal.
    #[must_use]
    pub fn new(model_sha256: &str, codes: Codes, place: [f32; 2], facing: f32) -> Self {
        Self {
            model: identity(model_sha256),
            codes,
            place,
            facing,
        }
    }

    /// Whether the dance was the same model's.
    #[must_use]
    pub fn is_of(&self, model_sha256: &str) -> bool {
        self.model == identity(model_sha256)
    }

    /// As text that is safe in a URL.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut bytes = vec![VERSION];
        bytes.extend(self.model);
        for number in [self.facing, self.place[0], self.place[1]] {
            bytes.extend(number.to_le_bytes());
        }
        for (&upper, &lower) in self.codes.upper.iter().zip(&self.codes.lower) {
            for code in [upper, lower] {
                // A dance with larger codes has no tail.
                bytes.extend(u16::try_from(code).unwrap_or(u16::MAX).to_le_bytes());
            }
        }
        URL_SAFE_NO_PAD.encode(bytes)
    }

    /// Reads [`Tail::to_text`]; `None` for any other text.
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
        let (facing, x, z) = (within(TAU)?, within(FURTHEST)?, within(FURTHEST)?);
        let (pairs, rest) = codes.as_chunks::<4>();
        if version != VERSION || pairs.is_empty() || !rest.is_empty() {
            return None;
        }
        let half = |of: fn([u8; 4]) -> [u8; 2]| {
            let codes = pairs.iter().map(|&pair| u16::from_le_bytes(of(pair)));
            codes.map(u32::from).collect()
        };
        Some(Self {
            model: *model,
            codes: Codes {
                upper: half(|[a, b, _, _]| [a, b]),
                lower: half(|[_, _, a, b]| [a, b]),
            },
            place: [x, z],
            facing,
        })
    }
}

impl std::str::FromStr for Tail {
    type Err = FormatError;

    fn from_str(text: &str) -> Result<Self, FormatError> {
        Self::read(text).ok_or(FormatError::Tail)
    }
}

/// The first bytes that a text of hexadecimal digits stands for.
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

    fn tail(pairs: u32) -> Tail {
        let codes = Codes {
            upper: (0..pairs).collect(),
            lower: (0..pairs).map(|code| 511 - code).collect(),
        };
        Tail::new(MODEL, codes, [1.5, -2.25], 0.75)
    }

    #[test]
    fn it_is_read_as_it_was_written_and_knows_its_model() {
        let tail = tail(26);
        let text = tail.to_text();
        assert!(text.len() <= 256, "{}", text.len());
        assert_eq!(text.parse::<Tail>().unwrap(), tail);
        assert!(tail.is_of(MODEL));
        assert!(!tail.is_of("fedcba98"));
    }

    #[test]
    fn other_texts_are_refused() {
        let text = tail(2).to_text();
        let short = text.get(..text.len() - 3).unwrap();
        let none = tail(0).to_text();
        let far = Tail {
            place: [f32::NAN, 0.0],
            ..tail(1)
        };
        let turned = Tail {
            facing: 100.0,
            ..tail(1)
        };
        let gone = Tail {
            place: [0.0, 1e30],
            ..tail(1)
        };
        let odd = [far, turned, gone].map(|tail| tail.to_text());
        let texts = ["", "x", "AAAA", short, &none, "%%%%"];
        for text in texts.into_iter().chain(odd.iter().map(String::as_str)) {
            assert!(text.parse::<Tail>().is_err(), "{text}");
        }
    }
}
