//! The model directory that an adaptation starts from, where that is no run.

use std::path::Path;

use bailando::model::{Manifest, ModelDirectory};
use serde_json::Value;

use super::{
    config::{AblationConfig, Config, DataConfig, GptConfig},
    error::TrainError,
    export,
    policy::Policy,
};
use crate::{
    export::{DECODER_FILE, GPT_FILE, write_with_gpt},
    onnx::{GraphWeights, InputRanges},
    weights::{GptWeights, MotionWeights},
};

/// A model directory as the server runs it, with weights that can learn.
pub struct ServedModel {
    directory: ModelDirectory,
    gpt: GptWeights,
    ranges: InputRanges,
    motion: MotionWeights,
}

impl ServedModel {
    /// Reads a model directory that this program has written.
    ///
    /// # Errors
    /// [`TrainError`] names the file and what is wrong with it.
    pub fn open(path: &Path) -> Result<Self, TrainError> {
        let directory = ModelDirectory::open(path).map_err(|error| TrainError::Config {
            path: path.to_owned(),
            message: error.to_string(),
        })?;
        let graph = |name: &str| GraphWeights::open(&directory.root().join(name));
        let mut gpt = graph(GPT_FILE)?;
        let model = Self {
            ranges: gpt.input_ranges(),
            gpt: GptWeights::from_graph(&mut gpt, directory.manifest().gpt.heads)?,
            motion: MotionWeights::from_graph(&mut graph(DECODER_FILE)?)?,
            directory,
        };
        match model.fits() {
            true => Ok(model),
            false => Err(TrainError::Config {
                path: path.to_owned(),
                message: "the graphs have other sizes than the manifest says".into(),
            }),
        }
    }

    /// Whether the weights have the sizes of the manifest.
    fn fits(&self) -> bool {
        let (gpt, manifest) = (&self.gpt, self.manifest());
        let codes = [manifest.vocabulary.upper, manifest.vocabulary.lower];
        let embeddings = [&gpt.upper_embedding, &gpt.lower_embedding];
        let root = self.motion.root.as_ref().map(|root| root.output.weight.dim(0));
        embeddings.map(|table| table.dim(0)) == codes
            && self.motion.codebooks.each_ref().map(|entries| entries.dim(0)) == codes
            && gpt.columns() == manifest.conditioning_columns()
            && (gpt.block(), gpt.channels()) == (manifest.gpt.block, manifest.gpt.channels)
            && gpt.blocks.len() == manifest.gpt.layers
            && root == Some(manifest.motion_frame.columns(1))
    }

    /// Writes the model of a finished run into its folder, and reads it.
    ///
    /// # Errors
    /// As `export`, and as [`ServedModel::open`].
    pub fn of_run(config: &Config) -> Result<Self, TrainError> {
        config.ablation.refuse("adapt")?;
        let folder = config.run.folder.join("adapted").join("base");
        export::write(config, &folder, Policy::latest(config)?, true, [])?;
        Self::open(&folder)
    }

    /// Returns settings of how to learn with the model's own of what learns.
    #[must_use]
    pub fn settings(&self, config: Config) -> Config {
        let manifest = self.manifest();
        let (features, gpt) = (&manifest.features, manifest.gpt);
        let base_layers = self.base_layers();
        let data = DataConfig {
            profile: features.profile,
            count_periods: features.count_periods.clone(),
            counts: features.counts,
            frame: manifest.motion_frame,
            ..config.data
        };
        let gpt = GptConfig {
            block: gpt.block,
            channels: gpt.channels,
            heads: gpt.heads,
            base_layers,
            head_layers: gpt.layers.saturating_sub(base_layers),
            ..config.gpt
        };
        Config { data, gpt, ablation: AblationConfig::default(), ..config }
    }

    /// Blocks of the state network, which rewards leave as it is: half of all, as published, where
    /// the model does not say.
    fn base_layers(&self) -> usize {
        let manifest = self.manifest();
        let settings = manifest.training.get("settings");
        let told = settings.and_then(|settings| settings.pointer("/gpt/base_layers"));
        let told = told.and_then(Value::as_u64).and_then(|layers| usize::try_from(layers).ok());
        let layers = manifest.gpt.layers;
        told.filter(|&told| told < layers).unwrap_or(layers / 2)
    }

    /// How much later than the tracker's the model's counts are, in seconds.
    #[must_use]
    pub fn counts_late_s(&self) -> f64 {
        self.manifest().features.counts_late_s
    }

    /// Returns the model directory.
    pub(super) fn root(&self) -> &Path {
        self.directory.root()
    }

    /// Returns the temperature that the model is served at; 1 where it takes the likeliest code.
    pub(super) fn temperature(&self) -> f32 {
        let temperature = self.manifest().sampling.temperature;
        if temperature > 0.0 { temperature } else { 1.0 }
    }

    pub(super) fn manifest(&self) -> &Manifest {
        self.directory.manifest()
    }

    /// Returns the SHA-256 of its manifest, which has those of all its files.
    pub(super) fn sha256(&self) -> &str {
        self.directory.manifest_sha256()
    }

    pub(super) fn gpt(&self) -> &GptWeights {
        &self.gpt
    }

    pub(super) fn policy(&self) -> Policy {
        Policy::of_model(&self.gpt, self.manifest())
    }

    pub(super) fn motion(&self) -> &MotionWeights {
        &self.motion
    }

    /// Writes the model with another policy.
    pub(super) fn write(
        &self,
        place: (&Path, bool),
        policy: &Policy,
        facts: impl IntoIterator<Item = (String, Value)>,
    ) -> Result<Manifest, TrainError> {
        let manifest = Manifest {
            start_codes: policy.starts.clone(),
            style_start_codes: policy.style_starts.clone(),
            ..self.manifest().clone()
        };
        let (root, weights) = (self.root(), policy.weights());
        Ok(write_with_gpt((root, manifest), place, &weights, &self.ranges, facts)?)
    }
}
