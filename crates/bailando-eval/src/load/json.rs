//! Positions and codes of our JSON results.

use std::str::FromStr;

use base64::{Engine, engine::general_purpose::STANDARD};
use ndarray::Array3;
use serde::Deserialize;

use super::check_rate;
use crate::body::JOINTS;

/// What a JSON result holds for the metrics.
#[derive(Debug)]
pub(super) struct JsonMotion {
    /// `[frames, 24, 3]`, metres.
    pub(super) positions: Array3<f32>,
    /// Upper and lower body.
    pub(super) codes: [Vec<u32>; 2],
}

#[derive(Deserialize)]
struct Document {
    fps: f64,
    frames: usize,
    #[serde(default)]
    codes: Codes,
    positions: Numbers,
}

#[derive(Default, Deserialize)]
struct Codes {
    upper: Vec<u32>,
    lower: Vec<u32>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Numbers {
    Nested(Vec<Vec<[f32; 3]>>),
    Packed(String),
}

impl FromStr for JsonMotion {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let document: Document = serde_json::from_str(text)
            .map_err(|error| format!("it is no JSON result of this program: {error}"))?;
        check_rate(document.fps)?;
        let values = match document.positions {
            Numbers::Nested(frames) => {
                if let Some(frame) = frames.iter().position(|pose| pose.len() != JOINTS) {
                    return Err(format!("frame {frame} does not have {JOINTS} joints"));
                }
                frames.into_iter().flatten().flatten().collect()
            }
            Numbers::Packed(text) => unpacked(&text)?,
        };
        let found = values.len();
        let positions =
            Array3::from_shape_vec((document.frames, JOINTS, 3), values).map_err(|_| {
                format!(
                    "{found} numbers are not {} frames of {JOINTS} joints",
                    document.frames
                )
            })?;
        let Codes { upper, lower } = document.codes;
        Ok(Self {
            positions,
            codes: [upper, lower],
        })
    }
}

fn unpacked(text: &str) -> Result<Vec<f32>, String> {
    let bytes = STANDARD
        .decode(text)
        .map_err(|error| format!("positions are no base64: {error}"))?;
    let (numbers, rest) = bytes.as_chunks::<4>();
    if !rest.is_empty() {
        return Err("positions are no whole number of float32".into());
    }
    Ok(numbers
        .iter()
        .map(|&number| f32::from_le_bytes(number))
        .collect())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn both_encodings_are_read() {
        let value =
            |frame: usize, joint: usize, axis: usize| (frame * 100 + joint * 3 + axis) as f32;
        let expected = Array3::from_shape_fn((5, JOINTS, 3), |(f, j, a)| value(f, j, a));
        let nested: Vec<Vec<[f32; 3]>> = (0..5)
            .map(|f| {
                (0..JOINTS)
                    .map(|j| [0, 1, 2].map(|a| value(f, j, a)))
                    .collect()
            })
            .collect();
        let bytes: Vec<u8> = expected.iter().flat_map(|v| v.to_le_bytes()).collect();
        for positions in [json!(nested), json!(STANDARD.encode(bytes))] {
            let text = json!({"fps": 60, "frames": 5, "positions": positions,
                "codes": {"upper": [1, 2], "lower": [3, 4]}, "model": "m"});
            let motion: JsonMotion = text.to_string().parse().unwrap();
            assert_eq!(motion.positions, expected);
            assert_eq!(motion.codes, [vec![1, 2], vec![3, 4]]);
        }
    }

    #[test]
    fn what_does_not_fit_is_said() {
        let pose = vec![[0.0; 3]; JOINTS];
        for (text, words) in [
            (
                json!({"fps": 30, "frames": 1, "positions": [pose]}),
                "30 frames a second",
            ),
            (
                json!({"fps": 60, "frames": 2, "positions": [pose]}),
                "72 numbers",
            ),
            (
                json!({"fps": 60, "frames": 1, "positions": [[[0.0, 0.0, 0.0]]]}),
                "frame 0",
            ),
            (json!({"fps": 60, "frames": 1, "positions": "!!"}), "base64"),
            (
                json!({"fps": 60, "frames": 1, "positions": "AAA="}),
                "float32",
            ),
            (json!({"beats": []}), "no JSON result"),
        ] {
            let message = text.to_string().parse::<JsonMotion>().unwrap_err();
            assert!(message.contains(words), "{message}");
        }
    }
}
