//! Positions and codes of our JSON results.

use base64::{Engine, engine::general_purpose::STANDARD};
use ndarray::Array3;
use serde::Deserialize;

use crate::body::{JOINTS, check_rate};

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

/// Returns positions `[frames, 24, 3]` in metres, and the codes of upper and lower body.
pub(super) fn read(text: &str) -> Result<(Array3<f32>, [Vec<u32>; 2]), String> {
    let document: Document = serde_json::from_str(text)
        .map_err(|error| format!("it is no JSON result of this program: {error}"))?;
    check_rate(document.fps)?;
    let values = match document.positions {
        Numbers::Nested(poses) => {
            if let Some(frame) = poses.iter().position(|pose| pose.len() != JOINTS) {
                return Err(format!("frame {frame} does not have {JOINTS} joints"));
            }
            poses.into_iter().flatten().flatten().collect()
        }
        Numbers::Packed(text) => unpacked(&text)?,
    };
    let (found, frames) = (values.len(), document.frames);
    let positions = Array3::from_shape_vec((frames, JOINTS, 3), values)
        .map_err(|_| format!("{found} numbers are not {frames} frames of {JOINTS} joints"))?;
    Ok((positions, [document.codes.upper, document.codes.lower]))
}

fn unpacked(text: &str) -> Result<Vec<f32>, String> {
    let bytes = STANDARD.decode(text);
    let bytes = bytes.map_err(|error| format!("positions are no base64: {error}"))?;
    let (numbers, rest) = bytes.as_chunks::<4>();
    if !rest.is_empty() {
        return Err("positions are no whole number of float32".into());
    }
    Ok(numbers.iter().copied().map(f32::from_le_bytes).collect())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn both_encodings_are_read() {
        let value = |f: usize, j: usize, a: usize| (f * 100 + j * 3 + a) as f32;
        let expected = Array3::from_shape_fn((5, JOINTS, 3), |(f, j, a)| value(f, j, a));
        let pose = |f| (0..JOINTS).map(move |j| [0, 1, 2].map(|a| value(f, j, a)));
        let nested: Vec<Vec<[f32; 3]>> = (0..5).map(|f| pose(f).collect()).collect();
        let bytes: Vec<u8> = expected.iter().flat_map(|v| v.to_le_bytes()).collect();
        for positions in [json!(nested), json!(STANDARD.encode(bytes))] {
            let text = json!({"fps": 60, "frames": 5, "positions": positions,
                "codes": {"upper": [1, 2], "lower": [3, 4]}, "model": "m"});
            let (positions, codes) = read(&text.to_string()).unwrap();
            assert_eq!(positions, expected);
            assert_eq!(codes, [vec![1, 2], vec![3, 4]]);
        }
    }

    #[test]
    fn errors_say_what_does_not_fit() {
        let one = json!([vec![[0.0; 3]; JOINTS]]);
        let document = |fps: u32, frames: u32, positions: serde_json::Value| serde_json::json!({"fps": fps, "frames": frames, "positions": positions});
        for (text, words) in [
            (document(30, 1, one.clone()), "30 frames a second"),
            (document(60, 2, one), "72 numbers"),
            (document(60, 1, json!([[[0.0, 0.0, 0.0]]])), "frame 0"),
            (document(60, 1, json!("!!")), "base64"),
            (document(60, 1, json!("AAA=")), "float32"),
            (json!({"beats": []}), "no JSON result"),
        ] {
            let message = read(&text.to_string()).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
    }
}
