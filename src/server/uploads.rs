//! Bodies on their way: how many at once, and how many bytes of them are held.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use prometheus_client::metrics::gauge::Gauge;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{
    body::BodyError,
    config::{ByteSize, Limits, Seconds},
    error::ServerError,
    metrics::{Counted, SharedMetrics},
};

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

    /// A place for one body, which is taken before anything of it is read (RELIABILITY, defence 2). Whoever
    /// finds no room, now or later, may ask again after `retry_after`.
    ///
    /// # Errors
    /// [`ServerError::TooManyUploads`].
    pub(crate) fn begin(&self, retry_after: Seconds) -> Result<UploadPermit, ServerError> {
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| {
            ServerError::TooManyUploads {
                most: self.most,
                retry_after,
            }
        })?;
        Ok(UploadPermit {
            place: Some((place, Counted::new(&self.metrics.uploads))),
            held: Arc::new(Held {
                all: Arc::clone(&self.bytes),
                taken: Mutex::new(None),
                gauge: self.metrics.upload_bytes.clone(),
                retry_after,
            }),
            of_job: None,
        })
    }

    /// Counts what `permit` holds among the uploads of jobs too.
    ///
    /// # Errors
    /// [`ServerError::UploadMemory`] where jobs hold too much already.
    pub(crate) fn keep_for_job(&self, permit: &mut UploadPermit) -> Result<(), ServerError> {
        // One upload may be larger than that half.
        let half = usize::try_from(self.memory.0 / 2).unwrap_or(usize::MAX);
        let held = permit.held.bytes().min(half);
        let kept = u32::try_from(held)
            .ok()
            .and_then(|held| Arc::clone(&self.of_jobs).try_acquire_many_owned(held).ok());
        permit.of_job = Some(kept.ok_or(ServerError::UploadMemory {
            memory: self.memory,
            retry_after: permit.held.retry_after,
        })?);
        Ok(())
    }
}

/// The right to receive one body, and to hold what came of it.
#[derive(Debug)]
pub(crate) struct UploadPermit {
    place: Option<(OwnedSemaphorePermit, Counted)>,
    held: Arc<Held>,
    of_job: Option<OwnedSemaphorePermit>,
}

impl UploadPermit {
    /// The count of what is held of the body.
    pub(crate) fn held(&self) -> Arc<Held> {
        Arc::clone(&self.held)
    }

    /// The body is here: it is held, but no longer on its way.
    pub(crate) fn received(&mut self) {
        self.place = None;
    }
}

/// Bytes of one body that are held, among those of all.
#[derive(Debug)]
pub(crate) struct Held {
    all: Arc<Semaphore>,
    // Held only to add to it or to look at it.
    taken: Mutex<Option<OwnedSemaphorePermit>>,
    gauge: Gauge,
    retry_after: Seconds,
}

impl Held {
    fn taken(&self) -> MutexGuard<'_, Option<OwnedSemaphorePermit>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Room for so many more bytes.
    ///
    /// # Errors
    /// [`BodyError::NoRoom`].
    pub(crate) fn more(&self, bytes: usize) -> Result<(), BodyError> {
        let count = u32::try_from(bytes).unwrap_or(u32::MAX);
        let more = Arc::clone(&self.all).try_acquire_many_owned(count);
        let more = more.map_err(|_| BodyError::NoRoom {
            retry_after: self.retry_after,
        })?;
        self.gauge.inc_by(i64::from(count));
        let mut taken = self.taken();
        match &mut *taken {
            Some(taken) => taken.merge(more),
            None => *taken = Some(more),
        }
        Ok(())
    }

    fn bytes(&self) -> usize {
        self.taken()
            .as_ref()
            .map_or(0, OwnedSemaphorePermit::num_permits)
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.gauge
            .dec_by(i64::try_from(self.bytes()).unwrap_or(i64::MAX));
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
        let soon = Seconds::new(2);
        let mut first = uploads.begin(soon).unwrap();
        assert!(matches!(
            uploads.begin(soon),
            Err(ServerError::TooManyUploads { most: 1, retry_after }) if retry_after == soon
        ));
        first.held().more(60).unwrap();
        first.received();
        let mut second = uploads.begin(soon).unwrap();
        second.held().more(40).unwrap();
        assert!(matches!(
            second.held().more(1),
            Err(BodyError::NoRoom { retry_after }) if retry_after == soon
        ));
        assert_eq!(
            (metrics.uploads.get(), metrics.upload_bytes.get()),
            (1, 100)
        );
        // Of which jobs may hold half.
        assert!(uploads.keep_for_job(&mut first).is_ok());
        assert!(matches!(
            uploads.keep_for_job(&mut second),
            Err(ServerError::UploadMemory { retry_after, .. }) if retry_after == soon
        ));
        drop(first);
        assert!(uploads.keep_for_job(&mut second).is_ok());
        second.held().more(60).unwrap();
        drop(second);
        assert_eq!((metrics.uploads.get(), metrics.upload_bytes.get()), (0, 0));
    }
}
