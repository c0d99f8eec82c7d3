//! The song of a job, on its way to the store while it arrives.

use bailando_jobs::{FileWriter, JobsError};
use bytes::Bytes;
use sha2::{Digest, Sha256};
use uuid::Uuid;

use super::service::Jobs;
use crate::server::{blocking, error::ServerError, metrics::SharedMetrics};

/// A song that is written as it arrives. Dropped before it is kept, it is not there.
pub(crate) struct SongWriter {
    id: Uuid,
    writer: FileWriter,
    hash: Sha256,
    bytes: u64,
    metrics: SharedMetrics,
}

impl SongWriter {
    /// The song of a new job.
    pub(crate) fn new(jobs: &Jobs, metrics: SharedMetrics) -> Self {
        let id = Uuid::new_v4();
        let writer = jobs.files.write(&Jobs::song(id));
        Self { id, writer, hash: Sha256::new(), bytes: 0, metrics }
    }

    /// The id of its job.
    pub(crate) fn id(&self) -> Uuid {
        self.id
    }

    /// Its size so far.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// SHA-256 of what was written.
    pub(crate) fn hash(&self) -> [u8; 32] {
        self.hash.clone().finalize().into()
    }

    /// Writes a piece; waits where the store is slower than the caller.
    ///
    /// # Errors
    /// [`ServerError::JobStore`].
    pub(crate) async fn push(&mut self, piece: Bytes) -> Result<(), ServerError> {
        let (mut hash, hashed) = (std::mem::take(&mut self.hash), piece.clone());
        let hash = blocking::blocking(&self.metrics, "upload", move || {
            hash.update(&hashed);
            Ok(hash)
        });
        self.hash = hash.await?;
        self.bytes += piece.len() as u64;
        Ok(self.writer.push(piece).await?)
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`JobsError::Store`].
    pub(crate) async fn keep(self) -> Result<(), JobsError> {
        self.writer.finish().await.map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::{config::Limits, jobs::storage::JobStorage};

    const PIECE: usize = 1 << 20;

    /// A song of 20 MiB, of which the store has parts already.
    async fn written(jobs: &Jobs) -> SongWriter {
        let mut song = SongWriter::new(jobs, SharedMetrics::default());
        for number in 0..20 {
            song.push(Bytes::from(vec![number; PIECE])).await.unwrap();
        }
        song
    }

    #[tokio::test]
    async fn a_song_is_there_once_it_is_kept_with_the_hash_of_all_of_it() {
        let jobs = Jobs::new(JobStorage::default(), &Limits::default());
        let song = written(&jobs).await;
        let (hash, name) = (song.hash(), Jobs::song(song.id()));
        assert!(matches!(jobs.files.read(&name, None).await, Err(JobsError::NoFile { .. })));
        song.keep().await.unwrap();
        let whole = jobs.files.read_whole(&name).await.unwrap();
        let expected: Vec<u8> = (0..20).flat_map(|number| vec![number; PIECE]).collect();
        assert!(whole == expected);
        assert_eq!(hash, <[u8; 32]>::from(Sha256::digest(&whole)));
    }

    #[tokio::test]
    async fn a_song_that_breaks_off_is_not_there() {
        let jobs = Jobs::new(JobStorage::default(), &Limits::default());
        let song = written(&jobs).await;
        let name = Jobs::song(song.id());
        drop(song);
        assert!(matches!(jobs.files.read(&name, None).await, Err(JobsError::NoFile { .. })));
    }
}
