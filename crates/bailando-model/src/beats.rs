//! The network that tells beats and first beats of bars from the rest of a song.
//!
//! Beat activations: BeatNet, (c) Mojtaba Heydari, Frank Cwitkowitz and Zhiyao Duan,
//! <https://github.com/mjhydri/BeatNet>, licensed under CC BY 4.0
//! (<https://creativecommons.org/licenses/by/4.0/>); converted from PyTorch to ONNX, softmax
//! included.

use ndarray::{Array2, Array4, ArrayView2, Ix2};
use ort::{session::SessionOutputs, value::DynValue};

use super::{
    ModelError,
    error::one_line,
    session::{Graph, floats, take},
};
use bailando_core::CancelToken;
use bailando_features::{BeatFinder, FeatureError, SongBeats};

const NAME: &str = "beatnet-state.onnx";
/// The graph is part of the program: every model needs it, it is small, and a program without it
/// beside a model directory of somebody else's would have no beats.
const GRAPH: &[u8] = include_bytes!("../../../models/beats/beatnet-state.onnx");
/// Shape of the hidden and of the cell state: layers, directions, batch, width.
const STATE: [usize; 4] = [2, 1, 1, 150];

/// A session of the beat network. The graph is part of the program.
#[derive(Debug)]
pub struct BeatNetwork {
    graph: Graph,
}

impl BeatNetwork {
    /// Loads the network; it computes on one thread.
    ///
    /// # Errors
    /// [`ModelError::Runtime`] without ONNX Runtime, [`ModelError::Graph`] or
    /// [`ModelError::Mismatch`] if it does not take the graph.
    pub fn open() -> Result<Self, ModelError> {
        let graph = Graph::built_in(NAME, GRAPH)?;
        graph.expect_inputs(NAME.as_ref(), &["features", "h_0", "c_0"].map(str::to_owned))?;
        Ok(Self { graph })
    }

    /// Finds the beats of a song, mono at [`BeatFinder::HZ`]; stops soon after `cancel` is
    /// triggered.
    ///
    /// # Errors
    /// Those of [`BeatFinder::find`] and [`BeatActivations::next`].
    pub fn beats<E: From<FeatureError> + From<ModelError>>(
        &mut self,
        finder: &mut BeatFinder,
        pcm: &[f32],
        cancel: &CancelToken,
    ) -> Result<SongBeats, E> {
        let mut song = self.start();
        finder.find(pcm, cancel, |rows| song.next(rows).map_err(E::from))
    }

    /// Begins a song.
    pub fn start(&mut self) -> BeatActivations<'_> {
        BeatActivations { network: self, state: None }
    }
}

/// The network on its way through a song.
#[derive(Debug)]
pub struct BeatActivations<'a> {
    network: &'a mut BeatNetwork,
    /// Hidden and cell state after the rows so far; none before the first.
    state: Option<[DynValue; 2]>,
}

impl BeatActivations<'_> {
    /// Returns the probabilities of a beat, a first beat and neither, `[n, 3]`, for the song's next
    /// rows `[n, 272]`, at 50 a second
    /// ([`BeatFinder::find`](bailando_features::BeatFinder::find)).
    ///
    /// # Errors
    /// [`ModelError::Input`] for no rows or other columns, or [`ModelError::Run`].
    pub fn next(&mut self, rows: ArrayView2<'_, f32>) -> Result<Array2<f32>, ModelError> {
        let (count, columns) = rows.dim();
        if count == 0 || columns != BeatFinder::COLUMNS {
            return Err(ModelError::Input {
                what: "rows of the beat network",
                expected: format!("at least one of {} columns", BeatFinder::COLUMNS),
                got: format!("{count} of {columns}"),
            });
        }
        let zeros = || floats(NAME, Array4::<f32>::zeros(STATE).view());
        let [hidden, cell] = match self.state.take() {
            Some(state) => state,
            None => [zeros()?, zeros()?],
        };
        let inputs = vec![
            ("features".into(), floats(NAME, rows)?.into()),
            ("h_0".into(), hidden.into()),
            ("c_0".into(), cell.into()),
        ];
        let (activations, state) = self.network.graph.run(inputs, |outputs| {
            let activations = take_rows(outputs, count)?;
            let state = [take(NAME, outputs, "h_next")?, take(NAME, outputs, "c_next")?];
            Ok((activations, state))
        })?;
        self.state = Some(state);
        Ok(activations)
    }
}

/// Takes the activations of `count` rows out of a run.
fn take_rows(outputs: &mut SessionOutputs<'_>, count: usize) -> Result<Array2<f32>, ModelError> {
    let wrong = |problem: String| ModelError::Run { graph: NAME, problem };
    let value = take(NAME, outputs, "activations")?;
    let array = value.try_extract_array::<f32>().map_err(|e| wrong(one_line(&e)))?;
    let array = array.into_dimensionality::<Ix2>().map_err(|e| wrong(one_line(&e)))?;
    match array.dim() {
        (rows, 3) if rows == count => Ok(array.to_owned()),
        found => Err(wrong(format!("activations have shape {found:?}, expected ({count}, 3)"))),
    }
}

#[cfg(test)]
mod tests {
    use bailando_testkit::{arrays, fixture, project, read_json};
    use ndarray::{Axis, Slice, concatenate};
    use sha2::{Digest, Sha256};

    use super::*;

    #[test]
    fn the_graph_is_the_one_that_its_manifest_names() {
        let manifest = read_json(&project("models/beats/manifest.json"));
        let file = &manifest["files"][NAME];
        let hash: String = Sha256::digest(GRAPH).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(
            (file["bytes"].as_u64(), file["sha256"].as_str()),
            (Some(GRAPH.len() as u64), Some(hash.as_str()),)
        );
        let licence = std::fs::read_to_string(project("models/beats/LICENCE.md")).unwrap();
        assert!(licence.contains(manifest["attribution"].as_str().unwrap()));
    }

    #[test]
    fn activations_are_golden_whole_and_in_parts() {
        let rows = arrays::floats(&fixture("beats/demo_features.npy"));
        let expected = arrays::floats(&fixture("beats/demo_activations.npy"));
        let expected = expected.slice_axis(Axis(0), Slice::from(..rows.nrows())).to_owned();
        let mut network = BeatNetwork::open().unwrap();
        let whole = network.start().next(rows.view()).unwrap();
        arrays::assert_close(&whole, &expected, 1e-4, "at once");
        let mut song = network.start();
        let parts = [0..1, 1..90, 90..250];
        let parts = parts.map(|part| song.next(arrays::rows(&rows, part)).unwrap());
        let parts = concatenate(Axis(0), &parts.each_ref().map(|part| part.view())).unwrap();
        arrays::assert_close(&parts, &expected, 1e-4, "in parts");
    }

    #[test]
    fn rows_of_another_width_are_refused() {
        let mut network = BeatNetwork::open().unwrap();
        for (rows, columns) in [(0, 272), (3, 271)] {
            let refused = network.start().next(Array2::zeros((rows, columns)).view());
            let refused = refused.unwrap_err().to_string();
            assert!(refused.contains("272 columns") && !refused.contains('\n'), "{refused}");
        }
    }
}
