//! The song of a job, on its way to the store while it arrives.

use bailando_jobs::{FileWriter, JobsError};
use bytes::Bytes;
use sha2::{Digest, Sha256};
use uuid::Uuid;

use super::service::Jobs;
use crate::server::{blocking, error::ServerError, metrics::SharedMetrics, resources::HeldBytes};

/// A song that is written as it arrives. Dropped before it is kept, it is not there.
pub(crate) struct SongWriter {
    id: Uuid,
    writer: FileWriter,
    hash: Sha256,
    bytes: u64,
    /// What is held of the upload; the store has the rest.
    held: HeldBytes,
    given_back: u64,
    metrics: SharedMetrics,
}

impl SongWriter {
    /// The song of a new job. `held` counts what arrives, and gives back what the store has.
    pub(crate) fn new(jobs: &Jobs, held: HeldBytes, metrics: SharedMetrics) -> Self {
        let id = Uuid::new_v4();
        Self {
            id,
            writer: jobs.files.write(&Jobs::song(id)),
            hash: Sha256::new(),
            bytes: 0,
            held,
            given_back: 0,
            metrics,
        }
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
        self.writer.push(piece).await?;
        let written = self.bytes.saturating_sub(FileWriter::MOST_HELD as u64);
        self.held.give_back(written.saturating_sub(self.given_back));
        self.given_back = written.max(self.given_back);
        Ok(())
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
    use crate::server::{
        config::{ByteSize, Limits},
        jobs::storage::JobStorage,
        layers::client::Client,
        resources::Uploads,
    };

    const PIECE: usize = 1 << 20;

    #[tokio::test]
    async fn a_long_song_is_in_the_store_and_not_in_memory() {
        let metrics = SharedMetrics::default();
        let limits = Limits { upload_memory: ByteSize(20 << 20), ..Limits::default() };
        let mut place = Uploads::new(&limits, &metrics).begin(Client::Unknown).unwrap();
        let jobs = Jobs::new(JobStorage::default(), &limits);
        let mut song = SongWriter::new(&jobs, place.bytes(), metrics.clone());
        let whole: Vec<u8> = (0..40 * PIECE).map(|at| (at / 7) as u8).collect();
        for piece in whole.chunks(PIECE) {
            place.bytes().add(piece.len()).expect("what the store has is given back");
            song.push(Bytes::copy_from_slice(piece)).await.unwrap();
        }
        place.received();
        assert_eq!(metrics.upload_bytes.get(), FileWriter::MOST_HELD as i64);
        assert_eq!(song.hash(), <[u8; 32]>::from(Sha256::digest(&whole)));
        let name = Jobs::song(song.id());
        song.keep().await.unwrap();
        assert!(jobs.files.read_whole(&name).await.unwrap() == whole);
        drop(place);
        assert_eq!(metrics.upload_bytes.get(), 0);
    }

    #[tokio::test]
    async fn a_song_that_breaks_off_is_not_there() {
        let metrics = SharedMetrics::default();
        let limits = Limits::default();
        let place = Uploads::new(&limits, &metrics).begin(Client::Unknown).unwrap();
        let jobs = Jobs::new(JobStorage::default(), &limits);
        let mut song = SongWriter::new(&jobs, place.bytes(), metrics.clone());
        for _ in 0..20 {
            song.push(Bytes::from(vec![1; PIECE])).await.unwrap();
        }
        let name = Jobs::song(song.id());
        drop(song);
        assert!(matches!(jobs.files.read(&name, None).await, Err(JobsError::NoFile { .. })));
    }
}
