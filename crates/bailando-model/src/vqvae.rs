//! The pose VQ-VAE's decoder and encoder graphs (paper Eq. 1-3, ARCHITECTURE section 2).

use std::path::Path;

use ndarray::{Array2, Array3, ArrayView2, Axis, Slice};

use super::{
    Manifest, ModelError,
    error::one_line,
    session::{Graph, SessionOptions, floats, integers, take, take_matrices},
};

const DECODER: &str = "decoder.onnx";
const ENCODER: &str = "encoder.onnx";

/// Pose codes to motion columns.
#[derive(Debug)]
pub struct Decoder {
    graph: Graph,
    frames_per_code: usize,
    columns: usize,
}

impl Decoder {
    /// Loads the graph at `path`, sized by `manifest`.
    ///
    /// # Errors
    /// [`ModelError::Graph`], [`ModelError::Mismatch`] or [`ModelError::Runtime`].
    pub(super) fn open(
        path: &Path,
        manifest: &Manifest,
        options: SessionOptions,
    ) -> Result<Self, ModelError> {
        let graph = Graph::open(DECODER, path, options, false)?;
        graph.expect_inputs(path, &["upper".to_owned(), "lower".to_owned()])?;
        Ok(Self {
            graph,
            frames_per_code: manifest.frames_per_code,
            columns: manifest.decoded_columns(),
        })
    }

    /// Decodes a sequence of code pairs: `[8 codes, columns]`, root velocity in columns 0..2 and
    /// root-relative joints after them, metres, in the manifest's frame: see
    /// [`MotionFrame::into_world`](bailando_motion::MotionFrame::into_world). The ends see zero
    /// padding, so a motion is decoded whole or in chunks that overlap by the manifest's receptive
    /// field.
    ///
    /// # Errors
    /// [`ModelError::Input`] for no codes, or [`ModelError::Run`].
    pub fn decode(&mut self, codes: &[[u32; 2]]) -> Result<Array2<f32>, ModelError> {
        let motion = self.decode_batch(&[codes])?;
        Ok(motion.index_axis_move(Axis(0), 0))
    }

    /// Decodes several sequences of one length at once, to `[sequences, 8 codes, columns]`.
    ///
    /// # Errors
    /// [`ModelError::Input`] for no codes or different lengths, or [`ModelError::Run`].
    pub fn decode_batch(&mut self, sequences: &[&[[u32; 2]]]) -> Result<Array3<f32>, ModelError> {
        let length = sequences.first().map_or(0, |codes| codes.len());
        if length == 0 || sequences.iter().any(|codes| codes.len() != length) {
            let lengths: Vec<usize> = sequences.iter().map(|codes| codes.len()).collect();
            return Err(ModelError::Input {
                what: "pose codes",
                expected: "sequences of one length, at least one code each".into(),
                got: format!("lengths {lengths:?}"),
            });
        }
        let expected = [sequences.len(), length * self.frames_per_code];
        let columns = self.columns;
        let half = |half: usize| {
            let codes = sequences.iter().flat_map(|codes| codes.iter());
            integers(DECODER, sequences.len(), codes.map(|pair| i64::from(pair[half])))
        };
        let inputs = vec![("upper".into(), half(0)?.into()), ("lower".into(), half(1)?.into())];
        self.graph.run(inputs, |outputs| {
            let motion = take_matrices(DECODER, outputs, "motion", expected)?;
            let (.., found) = motion.dim();
            if found != columns {
                return Err(ModelError::Run {
                    graph: DECODER,
                    problem: format!("motion has {found} columns, expected {columns}"),
                });
            }
            Ok(motion)
        })
    }
}

/// Motion columns to pose codes.
#[derive(Debug)]
pub struct Encoder {
    graph: Graph,
    frames_per_code: usize,
    columns: usize,
}

impl Encoder {
    /// Loads the graph at `path`, sized by `manifest`.
    ///
    /// # Errors
    /// [`ModelError::Graph`], [`ModelError::Mismatch`] or [`ModelError::Runtime`].
    pub(super) fn open(
        path: &Path,
        manifest: &Manifest,
        options: SessionOptions,
    ) -> Result<Self, ModelError> {
        let graph = Graph::open(ENCODER, path, options, false)?;
        graph.expect_inputs(path, &["motion".to_owned()])?;
        Ok(Self {
            graph,
            frames_per_code: manifest.frames_per_code,
            columns: manifest.motion_columns(),
        })
    }

    /// Encodes root-relative motion `[frames, 3 joints]` (columns 0..2 are ignored) into pairs of
    /// upper and lower codes; frames beyond the last whole code are left out. A model of the
    /// dancer's frame wants the motion in that frame
    /// ([`to_dancer_frame`](bailando_motion::to_dancer_frame)), without its last column.
    ///
    /// # Errors
    /// [`ModelError::Input`] for another width or less than one code of frames, or
    /// [`ModelError::Run`].
    pub fn encode(&mut self, motion: ArrayView2<'_, f32>) -> Result<Vec<[u32; 2]>, ModelError> {
        let (frames, columns) = motion.dim();
        let whole = frames - frames % self.frames_per_code.max(1);
        if whole == 0 || columns != self.columns {
            return Err(ModelError::Input {
                what: "motion to encode",
                expected: format!(
                    "at least {} frames of {} columns",
                    self.frames_per_code, self.columns
                ),
                got: format!("{frames} frames of {columns} columns"),
            });
        }
        let motion = motion.slice_axis(Axis(0), Slice::from(..whole));
        let motion = motion.insert_axis(Axis(0));
        let inputs = vec![("motion".into(), floats(ENCODER, motion)?.into())];
        self.graph.run(inputs, |outputs| {
            let mut codes = |name: &str| -> Result<Vec<u32>, ModelError> {
                let value = take(ENCODER, outputs, name)?;
                let wrong = |problem: String| ModelError::Run { graph: ENCODER, problem };
                let (_, codes) =
                    value.try_extract_tensor::<i64>().map_err(|e| wrong(one_line(&e)))?;
                codes
                    .iter()
                    .map(|&code| u32::try_from(code).map_err(|e| wrong(one_line(&e))))
                    .collect()
            };
            code_pairs(&codes("upper")?, &codes("lower")?)
        })
    }
}

/// Pairs of upper and lower codes from the two halves.
///
/// # Errors
/// [`ModelError::Input`] when the halves differ in length.
pub fn code_pairs(upper: &[u32], lower: &[u32]) -> Result<Vec<[u32; 2]>, ModelError> {
    if upper.len() != lower.len() {
        return Err(ModelError::Input {
            what: "pose codes",
            expected: "as many upper as lower codes".into(),
            got: format!("{} upper and {} lower", upper.len(), lower.len()),
        });
    }
    let pairs = upper.iter().zip(lower);
    Ok(pairs.map(|(&upper, &lower)| [upper, lower]).collect())
}
