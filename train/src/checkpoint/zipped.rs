//! The zip container: `<name>/data.pkl` and one stored entry `<name>/data/<key>` per storage.

use std::io::{Cursor, Read};

use zip::{CompressionMethod, ZipArchive};

use super::{
    error::Problem,
    pickle::{self, MAX_PICKLE_BYTES, Pickled},
};

/// An opened zip container.
#[derive(Debug)]
pub(super) struct ZipFile {
    archive: ZipArchive<Cursor<Vec<u8>>>,
    /// Bytes of the whole file: no entry can hold more.
    length: u64,
    /// What stands before `/data.pkl`.
    folder: String,
}

impl ZipFile {
    pub(super) fn open(bytes: Vec<u8>) -> Result<(Self, Pickled), Problem> {
        let length = bytes.len() as u64;
        let archive = ZipArchive::new(Cursor::new(bytes)).map_err(zip_problem)?;
        // `torch.jit.save` adds the program.
        let is_program = |name: &str| name.ends_with("/constants.pkl") || name.contains("/code/");
        if archive.file_names().filter_map(Result::ok).any(|name| is_program(&name)) {
            return Err(Problem::TorchScript);
        }
        let folder = archive
            .file_names()
            .filter_map(Result::ok)
            .find_map(|name| Some(name.strip_suffix("/data.pkl")?.to_owned()));
        let mut file = Self {
            archive,
            length,
            folder: folder.ok_or_else(|| Problem::MissingEntry("*/data.pkl".into()))?,
        };
        file.check_byte_order()?;
        let pickle = file.entry("data.pkl", MAX_PICKLE_BYTES as u64)?;
        let pickled = pickle::interpret(&pickle)?;
        Ok((file, pickled))
    }

    pub(super) fn storage(&mut self, key: &str) -> Result<Vec<u8>, Problem> {
        self.entry(&format!("data/{key}"), self.length)
    }

    /// `byteorder` is there since PyTorch 2.1; before that only little-endian machines wrote files.
    fn check_byte_order(&mut self) -> Result<(), Problem> {
        match self.entry("byteorder", 16) {
            Ok(order) if order != b"little" => Err(Problem::ByteOrder),
            Ok(_) | Err(Problem::MissingEntry(_)) => Ok(()),
            Err(problem) => Err(problem),
        }
    }

    /// A stored entry's bytes, checksum verified.
    fn entry(&mut self, name: &str, limit: u64) -> Result<Vec<u8>, Problem> {
        let name = format!("{}/{name}", self.folder);
        if self.archive.index_for_name(&name).is_none() {
            return Err(Problem::MissingEntry(name));
        }
        let entry = self.archive.by_name(&name).map_err(zip_problem)?;
        // A stored entry's bytes lie in the file, so one that would unpack to more is a bomb.
        if entry.compression() != CompressionMethod::Stored || entry.encrypted() {
            return Err(Problem::NotStored(name));
        }
        let declared = entry.size();
        if declared > self.length {
            return Err(Problem::EntrySize { entry: name, declared, available: self.length });
        }
        if declared > limit {
            return Err(Problem::PickleSize { bytes: declared, limit });
        }
        let mut bytes = Vec::new();
        entry
            .take(limit)
            .read_to_end(&mut bytes)
            .map_err(|error| Problem::Zip(format!("entry `{name}`: {error}")))?;
        if bytes.len() as u64 == declared {
            return Ok(bytes);
        }
        Err(Problem::EntrySize { entry: name, declared, available: bytes.len() as u64 })
    }
}

fn zip_problem(error: zip::result::ZipError) -> Problem {
    Problem::Zip(error.to_string())
}
