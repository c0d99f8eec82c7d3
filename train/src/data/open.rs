//! Opening of a data folder, and its two splits.

use std::{collections::HashMap, path::Path};

use bailando::model::file_sha256;

use super::{
    aist,
    dataset::{Dataset, Defect, OpenOptions, Piece, Split},
    error::DataError,
    files, folder, json,
    portion::{Evaluation, Portion, Training},
};

impl Dataset {
    /// Opens a folder whose every entry can be used.
    ///
    /// # Errors
    /// [`DataError`], naming the first unusable entry; `check-data` lists them all.
    pub fn open(root: &Path, options: &OpenOptions) -> Result<Self, DataError> {
        let dataset = Self::survey(root, options)?;
        match dataset.defects.first() {
            None => Ok(dataset),
            Some(Defect { piece, what }) => Err(DataError::Entry {
                path: root.to_owned(),
                piece: piece.clone(),
                what: what.clone(),
            }),
        }
    }

    /// Opens a folder, and lists unusable entries as defects.
    pub(super) fn survey(root: &Path, options: &OpenOptions) -> Result<Self, DataError> {
        let audio = options.audio.as_deref();
        if root.join(folder::INDEX).is_file() {
            folder::read(root)
        } else if let Some(motions) = aist::motions(root)? {
            aist::read(root, &motions, audio)
        } else if let Some(recordings) = json::recordings(root)? {
            json::read(root, recordings, audio)
        } else {
            Err(DataError::Layout(root.to_owned()))
        }
    }

    /// Returns the training split.
    ///
    /// # Errors
    /// [`DataError::Empty`]; [`DataError::Leak`] when a test motion (by its bytes) is among the
    /// training pieces; [`DataError::Read`].
    pub fn training(&self) -> Result<Portion<Training>, DataError> {
        self.refuse_leaks()?;
        Portion::of(self)
    }

    /// Returns the test split.
    ///
    /// # Errors
    /// [`DataError::Empty`].
    pub fn evaluation(&self) -> Result<Portion<Evaluation>, DataError> {
        Portion::of(self)
    }

    fn refuse_leaks(&self) -> Result<(), DataError> {
        let mut seen: HashMap<String, (Split, String)> = HashMap::new();
        let mut files: Vec<&Piece> = self.pieces.iter().collect();
        files.sort_by_key(|piece| (&piece.motion, piece.split));
        files.dedup_by_key(|piece| (&piece.motion, piece.split));
        for piece in files {
            let path = piece.motion.path();
            let mut file = std::fs::File::open(path).map_err(files::failed(path))?;
            let hash = file_sha256(&mut file).map_err(files::failed(path))?;
            let name = path.file_name().unwrap_or_default();
            let name = name.to_string_lossy().into_owned();
            match seen.get(&hash) {
                Some((split, other)) if *split != piece.split => {
                    let (train, test) = match piece.split {
                        Split::Train => (name, other.clone()),
                        Split::Test => (other.clone(), name),
                    };
                    return Err(DataError::Leak { train, test });
                }
                _ => drop(seen.insert(hash, (piece.split, name))),
            }
        }
        Ok(())
    }
}
