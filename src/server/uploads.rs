//! Bodies on their way: how many at once, and how many bytes of them are held.

use std::sync::Arc;

use prometheus_client::metrics::gauge::Gauge;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{
    config::{ByteSize, Limits, Seconds},
    error::ServerError,
    metrics::{Counted, SharedMetrics},
};

/// When to ask again: an upload takes seconds.
const RETRY: Seconds = Seconds::new(2);

/// A bounded number of bodies, and of bytes of them.
#[derive(Debug)]
pub(crate) struct Uploads {
    places: Arc<Semaphore>,
    bytes: Arc<Semaphore>,
    /// Bytes that jobs may hold while they wait: half of all, so that there is room for who cannot wait.
    of_jobs: Arc<Semaphore>,
    most: usize,
    memory: ByteSize,
    metrics: SharedMetrics,
}

impl Uploads {
    pub(crate) fn new(limits: &Limits, metrics: SharedMetrics) -> Self {
        let memory = usize::try_from(limits.upload_memory.0).unwrap_or(usize::MAX);
        Self {
            places: Arc::new(Semaphore::new(limits.max_uploads.get())),
            bytes: Arc::new(Semaphore::new(memory.min(Semaphore::MAX_PERMITS))),
            of_jobs: Arc::new(Semaphore::new((memory / 2).min(Semaphore::MAX_PERMITS))),
            most: limits.max_uploads.get(),
            memory: limits.upload_memory,
            metrics,
        }
    }

    /// A place for one body, which is taken before anything of it is read (RELIABILITY, defence 2).
    ///
    /// # Errors
    /// [`ServerError::TooManyUploads`].
    pub(crate) fn begin(&self) -> Result<UploadPermit, ServerError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        Ok(UploadPermit {
            place: Some((
                place.map_err(|_| ServerError::TooManyUploads {
                    most: self.most,
                    retry_after: RETRY,
                })?,
                Counted::new(&self.metrics.uploads),
            )),
            bytes: Arc::clone(&self.bytes),
            held: None,
            of_job: None,
            counted: 0,
            gauge: self.metrics.upload_bytes.clone(),
            memory: self.memory,
        })
    }
}

impl Uploads {
    /// Counts what `permit` holds among the uploads of jobs too.
    ///
    /// # Errors
    /// [`ServerError::UploadMemory`] where jobs hold too much already.
    pub(crate) fn keep_for_job(&self, permit: &mut UploadPermit) -> Result<(), ServerError> {
        // One upload may be larger than that half.
        let half = usize::try_from(self.memory.0 / 2).unwrap_or(usize::MAX);
        let held = usize::try_from(permit.counted).unwrap_or(0).min(half);
        let kept = u32::try_from(held)
            .ok()
            .and_then(|held| Arc::clone(&self.of_jobs).try_acquire_many_owned(held).ok());
        permit.of_job = Some(kept.ok_or(ServerError::UploadMemory {
            memory: self.memory,
            retry_after: RETRY,
        })?);
        Ok(())
    }
}

/// The right to receive one body, and to hold what came of it.
#[derive(Debug)]
pub(crate) struct UploadPermit {
    place: Option<(OwnedSemaphorePermit, Counted)>,
    bytes: Arc<Semaphore>,
    held: Option<OwnedSemaphorePermit>,
    of_job: Option<OwnedSemaphorePermit>,
    counted: i64,
    gauge: Gauge,
    memory: ByteSize,
}

impl UploadPermit {
    /// Room for so many more bytes.
    ///
    /// # Errors
    /// [`ServerError::UploadMemory`].
    pub(crate) fn hold(&mut self, bytes: usize) -> Result<(), ServerError> {
        let count = u32::try_from(bytes).unwrap_or(u32::MAX);
        let more = Arc::clone(&self.bytes)
            .try_acquire_many_owned(count)
            .map_err(|_| ServerError::UploadMemory {
                memory: self.memory,
                retry_after: RETRY,
            })?;
        match &mut self.held {
            Some(held) => held.merge(more),
            None => self.held = Some(more),
        }
        self.counted += i64::from(count);
        self.gauge.inc_by(i64::from(count));
        Ok(())
    }

    /// The body is here: it is held, but no longer on its way.
    pub(crate) fn received(&mut self) {
        self.place = None;
    }
}

impl Drop for UploadPermit {
    fn drop(&mut self) {
        self.gauge.dec_by(self.counted);
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;
    use crate::server::metrics::Metrics;

    #[test]
    fn places_and_bytes_are_bounded_and_given_back() {
        let metrics = SharedMetrics::new(Metrics::default());
        let limits = Limits {
            max_uploads: NonZeroUsize::MIN,
            upload_memory: ByteSize(100),
            ..Limits::default()
        };
        let uploads = Uploads::new(&limits, Arc::clone(&metrics));
        let mut first = uploads.begin().unwrap();
        assert!(matches!(
            uploads.begin(),
            Err(ServerError::TooManyUploads { most: 1, .. })
        ));
        first.hold(60).unwrap();
        first.received();
        let mut second = uploads.begin().unwrap();
        second.hold(40).unwrap();
        assert!(matches!(
            second.hold(1),
            Err(ServerError::UploadMemory { .. })
        ));
        assert_eq!(
            (metrics.uploads.get(), metrics.upload_bytes.get()),
            (1, 100)
        );
        // Of which jobs may hold half.
        assert!(uploads.keep_for_job(&mut first).is_ok());
        assert!(matches!(
            uploads.keep_for_job(&mut second),
            Err(ServerError::UploadMemory { .. })
        ));
        drop(first);
        assert!(uploads.keep_for_job(&mut second).is_ok());
        second.hold(60).unwrap();
        drop(second);
        assert_eq!((metrics.uploads.get(), metrics.upload_bytes.get()), (0, 0));
    }
}
