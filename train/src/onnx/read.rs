//! The tensors of a graph that was written here.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use half::f16;
use prost::Message;

use super::{InputRanges, proto, quantise};
use crate::{
    HostTensor,
    checkpoint::{CheckpointError, Problem},
    weights::Tensors,
};

/// The weights of a graph by their names: float16 widened, bytes times their column's scale.
#[derive(Debug)]
pub struct GraphWeights {
    path: PathBuf,
    stored: HashMap<String, proto::TensorData>,
}

impl GraphWeights {
    /// Opens the graph at `path`.
    ///
    /// # Errors
    /// [`CheckpointError::Read`] or [`CheckpointError::Malformed`].
    pub fn open(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = std::fs::read(path)
            .map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        Self::from_bytes(path, &bytes)
    }

    /// Opens a graph in memory; `path` is what errors call it.
    ///
    /// # Errors
    /// [`CheckpointError::Malformed`].
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, CheckpointError> {
        let path = path.to_owned();
        match proto::Model::decode(bytes) {
            Ok(model) => {
                let stored = model.graph.into_iter().flat_map(|graph| graph.initializer);
                let stored = stored.map(|tensor| (tensor.name.clone(), tensor)).collect();
                Ok(Self { path, stored })
            }
            Err(error) => {
                let problem = Problem::Onnx(error.to_string());
                Err(CheckpointError::Malformed { path, problem })
            }
        }
    }

    /// Returns what 8-bit matrices are multiplied with, as the graph has it.
    #[must_use]
    pub fn input_ranges(&self) -> InputRanges {
        let ranges = self.stored.iter().filter_map(|(name, step)| {
            let matrix = name.strip_suffix(".step")?;
            let &[step] = &floats(step).ok()?[..] else { return None };
            let of = |part: &str| self.stored.get(&format!("{matrix}.{part}"));
            // A product without a measured range has a step as well, but no centres.
            let (zero, _) = (of("zero")?.raw_data.first()?, of("centres")?);
            Some((matrix.to_owned(), quantise::range(step, *zero)))
        });
        ranges.collect()
    }

    /// Returns how a tensor is stored: in one of three ways.
    fn stored(&self, name: &str) -> Option<Stored<'_>> {
        let get = |suffix: &str| self.stored.get(&format!("{name}{suffix}"));
        let plain = get("").or_else(|| get(".f16")).map(Stored::Floats);
        plain.or_else(|| Some(Stored::Bytes { bytes: get(".int8")?, scales: get(".scales")? }))
    }
}

enum Stored<'a> {
    Floats(&'a proto::TensorData),
    /// `[rows, columns]`, and the scales of the columns.
    Bytes {
        bytes: &'a proto::TensorData,
        scales: &'a proto::TensorData,
    },
}

impl Stored<'_> {
    fn tensor(&self) -> Result<HostTensor, Problem> {
        let (shape, values) = match self {
            Self::Floats(tensor) => (&tensor.dims, floats(tensor)?),
            Self::Bytes { bytes, scales } => {
                let scales = floats(scales)?;
                let rows = bytes.raw_data.chunks(scales.len().max(1));
                let scaled = |(&byte, scale): (&u8, &f32)| f32::from(byte.cast_signed()) * scale;
                (&bytes.dims, rows.flat_map(|row| row.iter().zip(&scales).map(scaled)).collect())
            }
        };
        let shape: Vec<usize> =
            shape.iter().map(|&size| usize::try_from(size).unwrap_or(usize::MAX)).collect();
        if values.iter().any(|value| !value.is_finite()) {
            return Err(Problem::NotFinite);
        }
        HostTensor::new(shape, values).map_err(|error| Problem::Onnx(error.to_string()))
    }
}

impl Tensors for GraphWeights {
    fn path(&self) -> &Path {
        &self.path
    }

    fn contains(&self, name: &str) -> bool {
        self.stored(name).is_some()
    }

    fn tensor(&mut self, name: &str) -> Result<HostTensor, CheckpointError> {
        let (path, tensor) = (self.path.clone(), name.to_owned());
        match self.stored(name) {
            Some(stored) => {
                let failed = |problem| CheckpointError::Tensor { path, tensor, problem };
                stored.tensor().map_err(failed)
            }
            None => Err(CheckpointError::MissingTensor { path, tensor, hint: "" }),
        }
    }
}

/// Decodes floating-point numbers.
fn floats(tensor: &proto::TensorData) -> Result<Vec<f32>, Problem> {
    let raw = &tensor.raw_data;
    match tensor.data_type {
        proto::FLOAT => {
            let numbers = raw.as_chunks::<4>().0.iter();
            Ok(numbers.map(|&bytes| f32::from_le_bytes(bytes)).collect())
        }
        proto::FLOAT16 => {
            let numbers = raw.as_chunks::<2>().0.iter();
            Ok(numbers.map(|&bytes| f16::from_le_bytes(bytes).to_f32()).collect())
        }
        _ => Err(Problem::NotFloat("other")),
    }
}
