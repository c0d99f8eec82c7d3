//! A model directory: its manifest, and files that are what the manifest says.

use std::{
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
};

use sha2::{Digest, Sha256};

use super::{
    Decoder, Device, Encoder, Gpt, Manifest, ModelError, STYLES_FILE, StyleClassifier,
    installed::model_directory, session::SessionOptions,
};

/// Largest `manifest.json` and `styles.json` that is read.
const MANIFEST_LIMIT: u64 = 16 << 20;

/// A verified model directory.
#[derive(Clone, Debug)]
pub struct ModelDirectory {
    root: PathBuf,
    manifest: Manifest,
    manifest_sha256: String,
    device: Device,
}

impl ModelDirectory {
    /// Reads the manifest of `root` and checks every file it lists by size and SHA-256. A relative
    /// `root` that is not in the working directory is looked for around the executable.
    ///
    /// # Errors
    /// [`ModelError::Read`], [`ModelError::Outside`], [`ModelError::Manifest`] or
    /// [`ModelError::Mismatch`], naming the file.
    pub fn open(root: &Path) -> Result<Self, ModelError> {
        let root = &model_directory(root);
        let path = root.join("manifest.json");
        if !path.is_file() {
            return Err(ModelError::NoModel { path });
        }
        check_place(root, &path)?;
        let text = read_limited(&path, MANIFEST_LIMIT)?;
        let refuse = |problem: String| ModelError::Manifest { path: path.clone(), problem };
        let manifest: Manifest =
            serde_json::from_slice(&text).map_err(|e| refuse(e.to_string()))?;
        manifest.validate().map_err(refuse)?;
        for (name, entry) in &manifest.files {
            let path = root.join(name);
            check_place(root, &path)?;
            check_file(&path, entry.bytes, &entry.sha256)?;
        }
        let manifest_sha256 = hexadecimal(&Sha256::digest(&text));
        Ok(Self { root: root.to_path_buf(), manifest, manifest_sha256, device: Device::Cpu })
    }

    /// The same directory, whose graphs are computed on `device`, by default the processor.
    #[must_use]
    pub fn on(self, device: Device) -> Self {
        Self { device, ..self }
    }

    /// The folder.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The manifest.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// SHA-256 of the manifest, which names every other file's: it identifies the whole model.
    #[must_use]
    pub fn manifest_sha256(&self) -> &str {
        &self.manifest_sha256
    }

    /// Reads the classifier of songs by style; `None` where the manifest lists none.
    ///
    /// # Errors
    /// [`ModelError::Read`]; [`ModelError::Manifest`] for one that does not fit the manifest.
    pub fn style_classifier(&self) -> Result<Option<StyleClassifier>, ModelError> {
        if !self.manifest.files.contains_key(STYLES_FILE) {
            return Ok(None);
        }
        let path = self.root.join(STYLES_FILE);
        let text = read_limited(&path, MANIFEST_LIMIT)?;
        let refuse = |problem: String| ModelError::Manifest { path: path.clone(), problem };
        let classifier: StyleClassifier =
            serde_json::from_slice(&text).map_err(|error| refuse(error.to_string()))?;
        classifier.validate(&self.manifest.styles).map_err(refuse)?;
        Ok(Some(classifier))
    }

    fn session(&self, threads: usize) -> SessionOptions {
        SessionOptions { device: self.device, threads }
    }

    /// Loads the motion GPT.
    ///
    /// # Errors
    /// [`ModelError::Graph`], [`ModelError::Mismatch`], [`ModelError::Device`] or
    /// [`ModelError::Runtime`].
    pub fn gpt(&self, threads: usize) -> Result<Gpt, ModelError> {
        Gpt::open(&self.root.join("gpt.onnx"), &self.manifest, self.session(threads))
    }

    /// Loads the decoder.
    ///
    /// # Errors
    /// [`ModelError::Graph`], [`ModelError::Mismatch`], [`ModelError::Device`] or
    /// [`ModelError::Runtime`].
    pub fn decoder(&self, threads: usize) -> Result<Decoder, ModelError> {
        Decoder::open(&self.root.join("decoder.onnx"), &self.manifest, self.session(threads))
    }

    /// Loads the encoder.
    ///
    /// # Errors
    /// [`ModelError::Graph`], [`ModelError::Mismatch`], [`ModelError::Device`] or
    /// [`ModelError::Runtime`].
    pub fn encoder(&self, threads: usize) -> Result<Encoder, ModelError> {
        Encoder::open(&self.root.join("encoder.onnx"), &self.manifest, self.session(threads))
    }
}

/// Refuses a link out of `root`, and what is no file at all: a device or a pipe may never end.
fn check_place(root: &Path, path: &Path) -> Result<(), ModelError> {
    let failed = |reason| ModelError::Read { path: path.to_path_buf(), reason };
    let home = fs::canonicalize(root).map_err(failed)?;
    let place = fs::canonicalize(path).map_err(failed)?;
    if !place.starts_with(&home) {
        return Err(ModelError::Outside { path: path.to_path_buf() });
    }
    match fs::metadata(&place).map_err(failed)?.is_file() {
        true => Ok(()),
        false => Err(failed(io::Error::other("it is no regular file"))),
    }
}

fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, ModelError> {
    let failed = |reason| ModelError::Read { path: path.to_path_buf(), reason };
    let file = File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(limit).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

fn check_file(path: &Path, bytes: u64, sha256: &str) -> Result<(), ModelError> {
    let failed = |reason| ModelError::Read { path: path.to_path_buf(), reason };
    let mismatch = |what, expected: String, found: String| {
        Err(ModelError::Mismatch { path: path.to_path_buf(), what, expected, found })
    };
    let mut file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    if length != bytes {
        return mismatch("the size in bytes", bytes.to_string(), length.to_string());
    }
    let found = file_sha256(&mut file).map_err(failed)?;
    if found != sha256 {
        return mismatch("the SHA-256", sha256.to_owned(), found);
    }
    Ok(())
}

/// SHA-256 of everything `file` still holds, lower-case hexadecimal.
///
/// # Errors
/// Whatever reading gives.
pub fn file_sha256(file: &mut impl Read) -> io::Result<String> {
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        let read = file.read(&mut buffer)?;
        match buffer.get(..read) {
            None | Some([]) => return Ok(hexadecimal(&hash.finalize())),
            Some(part) => hash.update(part),
        }
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
