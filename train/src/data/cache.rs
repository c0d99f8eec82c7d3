//! Music features on disk, by content: the same audio, profile, rate and phase are computed once.

use std::{
    env, fs,
    io::{self, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use bailando::features::{COLUMNS, Profile, Rate};
use ndarray::Array2;
use sha2::{Digest, Sha256};

use super::{DataError, files};
use crate::sha256;

/// Raise it whenever decoding, resampling or features give other numbers: older entries are then
/// never asked for again.
const FEATURE_VERSION: u32 = 1;

const MAGIC: &[u8; 8] = b"bdrows01";
/// Magic, SHA-256 of the values, number of rows.
const HEADER: usize = 8 + 32 + 8;

/// What decides a song's feature rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FeatureKey {
    text: String,
}

impl FeatureKey {
    /// The key of the audio file with these bytes, without its first `phase` frames of motion.
    #[must_use]
    pub fn new(audio: &[u8], profile: Profile, rate: Rate, phase: usize) -> Self {
        let audio = sha256(audio);
        let profile = match profile {
            Profile::Librosa011 => "librosa-0.11",
            Profile::Librosa081 => "librosa-0.8.1",
        };
        Self { text: format!("{audio} {profile} {} {phase} {FEATURE_VERSION}", rate.hz()) }
    }

    fn file_name(&self) -> String {
        format!("{}.rows", sha256(self.text.as_bytes()))
    }
}

/// A folder of computed rows.
#[derive(Clone, Debug)]
pub struct FeatureCache {
    folder: PathBuf,
}

impl FeatureCache {
    /// Uses `folder`, which is made when it is not there.
    ///
    /// # Errors
    /// [`DataError::Cache`] if it cannot be made.
    pub fn open(folder: &Path) -> Result<Self, DataError> {
        fs::create_dir_all(folder).map_err(failed(folder))?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// `$XDG_CACHE_HOME/bailando/features`, else `~/.cache/bailando/features`: data folders may be
    /// read-only.
    ///
    /// # Errors
    /// [`DataError::NoCacheFolder`] without either variable.
    pub fn default_folder() -> Result<PathBuf, DataError> {
        let variable = |name| env::var_os(name).filter(|value| !value.is_empty());
        let cache = variable("XDG_CACHE_HOME").map(PathBuf::from);
        let cache = cache.or_else(|| Some(PathBuf::from(variable("HOME")?).join(".cache")));
        let cache = cache.ok_or(DataError::NoCacheFolder)?;
        Ok(cache.join("bailando").join("features"))
    }

    /// Uses `folder`, or without one [`FeatureCache::default_folder`].
    ///
    /// # Errors
    /// As of those two.
    pub fn open_or_default(folder: Option<&Path>) -> Result<Self, DataError> {
        match folder {
            Some(folder) => Self::open(folder),
            None => Self::open(&Self::default_folder()?),
        }
    }

    /// The rows of `key`; none when they were never stored, or the entry is damaged.
    #[must_use]
    pub fn get(&self, key: &FeatureKey) -> Option<Array2<f32>> {
        let bytes = files::read(&self.folder.join(key.file_name())).ok()?;
        decode(&bytes)
    }

    /// Stores rows: other processes see the whole entry or none.
    ///
    /// # Errors
    /// [`DataError::Cache`].
    pub fn put(&self, key: &FeatureKey, rows: &Array2<f32>) -> Result<(), DataError> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let path = self.folder.join(key.file_name());
        let number = COUNTER.fetch_add(1, Ordering::Relaxed);
        let process = std::process::id();
        let draft = self.folder.join(format!(".draft-{process}-{number}"));
        let write = || -> io::Result<()> {
            let mut file = fs::File::create(&draft)?;
            file.write_all(&encode(rows))?;
            file.sync_all()?;
            fs::rename(&draft, &path)
        };
        write().map_err(|source| {
            // A leftover is harmless: its name is asked for by no one.
            let _ = fs::remove_file(&draft);
            failed(&path)(source)
        })
    }
}

fn encode(rows: &Array2<f32>) -> Vec<u8> {
    let values: Vec<u8> = rows.iter().flat_map(|value| value.to_le_bytes()).collect();
    let mut bytes = Vec::with_capacity(HEADER + values.len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&Sha256::digest(&values));
    bytes.extend_from_slice(&(rows.nrows() as u64).to_le_bytes());
    bytes.extend_from_slice(&values);
    bytes
}

fn decode(bytes: &[u8]) -> Option<Array2<f32>> {
    let rest = bytes.strip_prefix(MAGIC)?;
    let (hash, rest) = rest.split_first_chunk::<32>()?;
    let (rows, values) = rest.split_first_chunk::<8>()?;
    let rows = usize::try_from(u64::from_le_bytes(*rows)).ok()?;
    if Sha256::digest(values).as_slice() != hash {
        return None;
    }
    let values = values.chunks_exact(4).filter_map(|chunk| chunk.try_into().ok());
    let values = values.map(f32::from_le_bytes).collect();
    Array2::from_shape_vec((rows, COLUMNS), values).ok()
}

fn failed(path: &Path) -> impl Fn(io::Error) -> DataError {
    let path = path.to_owned();
    move |source| DataError::Cache { path: path.clone(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Array2<f32> {
        Array2::from_shape_fn((3, COLUMNS), |(row, column)| (row * 1000 + column) as f32)
    }

    #[test]
    fn rows_come_back_bit_for_bit_and_leave_no_drafts() {
        let folder = tempfile::tempdir().unwrap();
        let cache = FeatureCache::open(&folder.path().join("a/b")).unwrap();
        let key = FeatureKey::new(b"song", Profile::Librosa011, Rate::Conditioning, 0);
        assert_eq!(cache.get(&key), None);
        cache.put(&key, &rows()).unwrap();
        assert_eq!(cache.get(&key), Some(rows()));
        assert_eq!(fs::read_dir(&cache.folder).unwrap().count(), 1);
    }

    #[test]
    fn everything_that_decides_the_rows_is_in_the_key() {
        let key = |audio: &[u8], profile, rate, phase| {
            FeatureKey::new(audio, profile, rate, phase).file_name()
        };
        let one = key(b"a", Profile::Librosa011, Rate::Conditioning, 0);
        let others = [
            key(b"b", Profile::Librosa011, Rate::Conditioning, 0),
            key(b"a", Profile::Librosa081, Rate::Conditioning, 0),
            key(b"a", Profile::Librosa011, Rate::Beats, 0),
            key(b"a", Profile::Librosa011, Rate::Conditioning, 1),
        ];
        assert!(!others.contains(&one));
        assert_eq!(one, key(b"a", Profile::Librosa011, Rate::Conditioning, 0));
    }

    #[test]
    fn any_damage_is_noticed() {
        let whole = encode(&rows());
        assert!(decode(&whole).is_some());
        for length in [0, 7, HEADER, whole.len() - 1] {
            assert_eq!(decode(&whole[..length]), None);
        }
        for position in [0, 8, 40, HEADER, whole.len() - 1] {
            let mut damaged = whole.clone();
            damaged[position] ^= 1;
            assert_eq!(decode(&damaged), None, "byte {position}");
        }
    }
}
