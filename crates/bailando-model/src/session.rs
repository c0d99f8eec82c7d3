//! One ONNX session and its runs.

use std::path::Path;

use ndarray::{Array3, ArrayView, Dimension, Ix3};
use ort::{
    ep,
    session::{Session, SessionInputValue, SessionOutputs, builder::SessionBuilder},
    value::{DynValue, Tensor},
};

use super::{Device, ModelError, cuda, embedded, error::one_line, runtime};

/// Named inputs of a run.
pub(super) type Inputs<'value> = Vec<(String, SessionInputValue<'value>)>;

/// How a graph is run.
#[derive(Clone, Copy, Debug)]
pub(super) struct SessionOptions {
    pub(super) device: Device,
    /// Threads of the processor that one node is computed with.
    pub(super) threads: usize,
}

/// A loaded graph.
#[derive(Debug)]
pub(super) struct Graph {
    name: &'static str,
    session: Session,
}

impl Graph {
    /// Loads the graph at `path`; `name` appears in errors. With `keeps_memory`, the memory of a
    /// run is kept for the next: it suits few shapes, and would grow with many.
    pub(super) fn open(
        name: &'static str,
        path: &Path,
        options: SessionOptions,
        keeps_memory: bool,
    ) -> Result<Self, ModelError> {
        embedded::check(path)?;
        let failed = |problem| ModelError::Graph { path: path.to_path_buf(), problem };
        let session = builder(options, keeps_memory)?.commit_from_file(path);
        Ok(Self { name, session: session.map_err(|e| failed(one_line(&e)))? })
    }

    /// Loads a graph that is part of the program.
    pub(super) fn built_in(name: &'static str, bytes: &'static [u8]) -> Result<Self, ModelError> {
        let failed = |problem| ModelError::Graph { path: name.into(), problem };
        let options = SessionOptions { device: Device::Cpu, threads: 1 };
        let session = builder(options, true)?.commit_from_memory(bytes);
        Ok(Self { name, session: session.map_err(|e| failed(one_line(&e)))? })
    }

    /// Checks that the graph has exactly the named inputs.
    pub(super) fn expect_inputs(&self, path: &Path, expected: &[String]) -> Result<(), ModelError> {
        let mut found: Vec<_> = self.session.inputs().iter().map(|i| i.name().to_owned()).collect();
        let mut expected = expected.to_vec();
        found.sort();
        expected.sort();
        if found == expected {
            return Ok(());
        }
        Err(ModelError::Mismatch {
            path: path.to_path_buf(),
            what: "the graph's list of inputs",
            expected: expected.join(" "),
            found: found.join(" "),
        })
    }

    /// Runs the graph and hands its outputs to `read`.
    pub(super) fn run<T>(
        &mut self,
        inputs: Inputs<'_>,
        read: impl FnOnce(&mut SessionOutputs<'_>) -> Result<T, ModelError>,
    ) -> Result<T, ModelError> {
        let graph = self.name;
        let mut outputs = self
            .session
            .run(inputs)
            .map_err(|e| ModelError::Run { graph, problem: one_line(&e) })?;
        read(&mut outputs)
    }
}

/// The settings of all sessions.
fn builder(options: SessionOptions, keeps_memory: bool) -> Result<SessionBuilder, ModelError> {
    let SessionOptions { device, threads } = options;
    let runtime = runtime::runtime()?;
    let failed = |error: ort::Error| ModelError::Runtime(one_line(&error));
    let mut builder = Session::builder(&runtime.environment).map_err(failed)?;
    // Providers take the nodes that they can run in the order of their registration.
    if let Device::Cuda { index } = device {
        cuda::register(&mut builder, index, &runtime.library)?;
    }
    let build = || -> ort::Result<SessionBuilder> {
        Ok(builder
            .with_intra_threads(threads)?
            .with_inter_threads(1)?
            .with_memory_pattern(keeps_memory)?
            .with_intra_op_spinning(false)?
            // Without VNNI, sums of unsigned times signed bytes saturate: unsigned ones do not.
            .with_config_entry("session.x64quantprecision", "1")?
            .with_execution_providers([ep::CPU::default()
                .with_arena_allocator(keeps_memory)
                .build()])?)
    };
    build().map_err(failed)
}

/// A tensor of 64-bit integers, `[rows, n]`.
pub(super) fn integers(
    graph: &'static str,
    rows: usize,
    values: impl Iterator<Item = i64>,
) -> Result<DynValue, ModelError> {
    let values: Vec<i64> = values.collect();
    let shape = [rows, values.len() / rows.max(1)];
    tensor(graph, Tensor::from_array((shape, values)))
}

/// A tensor of floats that owns a copy of `values`.
pub(super) fn floats<D: Dimension>(
    graph: &'static str,
    values: ArrayView<'_, f32, D>,
) -> Result<DynValue, ModelError> {
    let shape = values.shape().to_vec();
    tensor(graph, Tensor::from_array((shape, values.iter().copied().collect::<Vec<f32>>())))
}

pub(super) fn tensor<T: ort::value::PrimitiveTensorElementType + std::fmt::Debug>(
    graph: &'static str,
    result: ort::Result<Tensor<T>>,
) -> Result<DynValue, ModelError> {
    result.map(Tensor::into_dyn).map_err(|e| ModelError::Run { graph, problem: one_line(&e) })
}

/// Takes the named output out of a run.
pub(super) fn take(
    graph: &'static str,
    outputs: &mut SessionOutputs<'_>,
    name: &str,
) -> Result<DynValue, ModelError> {
    outputs
        .remove(name)
        .ok_or_else(|| ModelError::Run { graph, problem: format!("it has no output named {name}") })
}

/// Takes the named output `[batch, rows, columns]` out of a run.
pub(super) fn take_matrices(
    graph: &'static str,
    outputs: &mut SessionOutputs<'_>,
    name: &str,
    expected: [usize; 2],
) -> Result<Array3<f32>, ModelError> {
    let value = take(graph, outputs, name)?;
    let wrong = |problem: String| ModelError::Run { graph, problem };
    let array = value.try_extract_array::<f32>().map_err(|e| wrong(one_line(&e)))?;
    let array = array.into_dimensionality::<Ix3>().map_err(|e| wrong(one_line(&e)))?;
    let (batch, rows, _) = array.dim();
    if [batch, rows] != expected {
        let [batch, rows] = expected;
        let found = array.dim();
        let problem = format!("{name} has shape {found:?}, expected {batch} times {rows} rows");
        return Err(wrong(problem));
    }
    Ok(array.to_owned())
}
