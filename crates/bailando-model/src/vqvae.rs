//! The pose VQ-VAE's decoder and encoder graphs (paper Eq. 1-3, ARCHITECTURE section 2).

use std::path::Path;

use ndarray::{Array2, Array3, ArrayView2, Axis, Slice, aview1};

use super::{
    Manifest, ModelError,
    session::{Graph, floats, integer_rows, one_line, take, take_matrices},
};
use bailando_core::CancelToken;

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
    pub fn open(path: &Path, manifest: &Manifest, threads: usize) -> Result<Self, ModelError> {
        let graph = Graph::open(DECODER, path, threads, false)?;
        graph.expect_inputs(path, &["upper".to_owned(), "lower".to_owned()])?;
        Ok(Self {
            graph,
            frames_per_code: manifest.frames_per_code,
            columns: manifest.decoded_columns(),
        })
    }

    /// Decodes a run of code pairs at once: `[8 codes, columns]`, root velocity in columns 0..2 and
    /// root-relative joints behind them, metres, in the manifest's frame: see
    /// [`MotionFrame::into_world`](bailando_motion::MotionFrame::into_world). The ends see zero
    /// padding, so a piece is decoded whole or in chunks that overlap by the manifest's receptive
    /// field.
    ///
    /// # Errors
    /// [`ModelError::Input`] when the halves differ in length, [`ModelError::Cancelled`], or
    /// [`ModelError::Run`].
    pub fn decode(
        &mut self,
        upper: &[u32],
        lower: &[u32],
        cancel: &CancelToken,
    ) -> Result<Array2<f32>, ModelError> {
        let [upper, lower] = [upper, lower].map(|codes| aview1(codes).insert_axis(Axis(0)));
        let motion = self.decode_batch(upper, lower, cancel)?;
        Ok(motion.index_axis_move(Axis(0), 0))
    }

    /// Decodes several runs of one length at once, `[runs, codes]` to `[runs, 8 codes, columns]`.
    ///
    /// # Errors
    /// As [`Decoder::decode`].
    pub fn decode_batch(
        &mut self,
        upper: ArrayView2<'_, u32>,
        lower: ArrayView2<'_, u32>,
        cancel: &CancelToken,
    ) -> Result<Array3<f32>, ModelError> {
        if upper.is_empty() || upper.dim() != lower.dim() {
            return Err(ModelError::Input {
                what: "pose codes",
                expected: "as many upper as lower codes, at least one".into(),
                got: format!("{} upper and {} lower", upper.len(), lower.len()),
            });
        }
        let (runs, codes) = upper.dim();
        let expected = [runs, codes * self.frames_per_code];
        let columns = self.columns;
        let inputs = vec![
            ("upper".into(), integer_rows(DECODER, upper)?.into()),
            ("lower".into(), integer_rows(DECODER, lower)?.into()),
        ];
        self.graph.run(inputs, cancel, |outputs| {
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
    pub fn open(path: &Path, manifest: &Manifest, threads: usize) -> Result<Self, ModelError> {
        let graph = Graph::open(ENCODER, path, threads, false)?;
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
    /// [`ModelError::Input`] for another width or less than one code of frames,
    /// [`ModelError::Cancelled`], or [`ModelError::Run`].
    pub fn encode(
        &mut self,
        motion: ArrayView2<'_, f32>,
        cancel: &CancelToken,
    ) -> Result<(Vec<u32>, Vec<u32>), ModelError> {
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
        self.graph.run(inputs, cancel, |outputs| {
            let mut codes = |name: &str| -> Result<Vec<u32>, ModelError> {
                let value = take(ENCODER, outputs, name)?;
                let wrong = |problem: String| ModelError::Run {
                    graph: ENCODER,
                    problem,
                };
                let (_, codes) = value
                    .try_extract_tensor::<i64>()
                    .map_err(|e| wrong(one_line(&e)))?;
                codes
                    .iter()
                    .map(|&code| u32::try_from(code).map_err(|e| wrong(one_line(&e))))
                    .collect()
            };
            Ok((codes("upper")?, codes("lower")?))
        })
    }
}
