//! Bodies in transfer: how many at once, and how many bytes of them are held.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::Ordering};

use prometheus_client::metrics::gauge::Gauge;

use super::{
    budget::{Budget, Reservation},
    transfers::{Displaced, Transfer, Transfers},
};
use crate::server::{
    config::{ByteSize, Limits, Seconds},
    error::ServerError,
    layers::client::Client,
    metrics::Metrics,
};

/// A bounded number of bodies, and of bytes of them.
#[derive(Debug)]
pub(crate) struct Uploads {
    bodies: Arc<Transfers>,
    bytes: Budget,
    /// Bytes that jobs may hold while they wait: half of all, so that room is left for requests
    /// that cannot wait.
    job_bytes: Budget,
    memory: ByteSize,
}

impl Uploads {
    pub(crate) fn new(limits: &Limits, metrics: &Metrics) -> Self {
        let memory = limits.upload_memory;
        // Room for the largest file in any case.
        let share = |bytes| limits.share_of(bytes).max(limits.largest_body().0);
        let (most, jobs) = (limits.max_uploads.get(), memory.0 / 2);
        let bodies = limits.share_of(most as u64) as usize;
        Self {
            bodies: Transfers::new(most, bodies, metrics.uploads.clone()),
            bytes: Budget::shared(memory.0, share(memory.0), metrics.upload_bytes.clone()),
            job_bytes: Budget::shared(jobs, share(jobs), Gauge::default()),
            memory,
        }
    }

    /// Reserves a place for one body, before any of it is read (RELIABILITY, defence 2).
    ///
    /// # Errors
    /// [`ServerError::TooManyUploads`].
    pub(crate) fn begin(&self, client: Client) -> Result<UploadReservation, ServerError> {
        let body = self.bodies.begin(client);
        let bytes = self.bytes.try_reserve_for(client, 0).ok();
        let (body, bytes) = body.zip(bytes).ok_or_else(|| ServerError::TooManyUploads {
            most: self.bodies.most(),
            retry_after: self.bytes.retry_after(1),
        })?;
        Ok(UploadReservation {
            client,
            body: Some(body),
            bytes: HeldBytes(Arc::new(Mutex::new(bytes))),
            job_bytes: None,
        })
    }

    /// Counts what `upload` holds among the bytes of jobs too.
    ///
    /// # Errors
    /// [`ServerError::UploadMemory`] where jobs hold too much already.
    pub(crate) fn keep_for_job(&self, upload: &mut UploadReservation) -> Result<(), ServerError> {
        let held = upload.bytes.lock().units() as u64;
        // One upload may be larger than the half of all that jobs may hold.
        let units = self.job_bytes.clamp(held);
        let kept = self.job_bytes.try_reserve_for(upload.client, units.into());
        upload.job_bytes = Some(kept.map_err(|_| ServerError::UploadMemory {
            memory: self.memory,
            retry_after: self.job_bytes.retry_after(1),
        })?);
        Ok(())
    }
}

/// The right to receive one body, and to hold it until it is decoded.
#[derive(Debug)]
pub(crate) struct UploadReservation {
    client: Client,
    body: Option<Transfer>,
    bytes: HeldBytes,
    job_bytes: Option<Reservation>,
}

impl UploadReservation {
    /// The reservation that grows with the body.
    pub(crate) fn bytes(&self) -> HeldBytes {
        self.bytes.clone()
    }

    /// The trigger of a body that must give way to another, and a count of what has arrived of it.
    pub(crate) fn transfer(&self) -> Option<(Displaced, impl Fn(usize) + Send + use<>)> {
        let Transfer { bytes, displaced, .. } = self.body.as_ref()?;
        let bytes = Arc::clone(bytes);
        let arrived = move |more: usize| {
            bytes.fetch_add(more as u64, Ordering::Relaxed);
        };
        Some((displaced.clone(), arrived))
    }

    /// Ends the transfer: the body is held, but no longer on its way.
    pub(crate) fn received(&mut self) {
        self.body = None;
        self.bytes.lock().measure();
    }
}

/// Bytes of one body that are held, among those of all.
#[derive(Clone, Debug)]
pub(crate) struct HeldBytes(Arc<Mutex<Reservation>>);

impl HeldBytes {
    // Held only to add to the reservation or to look at it.
    fn lock(&self) -> MutexGuard<'_, Reservation> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reserves so many more bytes.
    ///
    /// # Errors
    /// When enough of them are probably free.
    pub(crate) fn add(&self, bytes: usize) -> Result<(), Seconds> {
        let mut held = self.lock();
        match held.try_grow(bytes) {
            true => Ok(()),
            false => Err(held.retry_after()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;

    #[test]
    fn bodies_and_bytes_are_bounded_and_given_back() {
        let metrics = Metrics::default();
        let limits = Limits {
            max_uploads: NonZeroUsize::MIN,
            upload_memory: ByteSize(100),
            ..Limits::default()
        };
        let uploads = Uploads::new(&limits, &metrics);
        let soon = Seconds::new(2);
        let mut first = uploads.begin(Client::Unknown).unwrap();
        assert!(matches!(
            uploads.begin(Client::Unknown),
            Err(ServerError::TooManyUploads { most: 1, retry_after }) if retry_after == soon
        ));
        first.bytes().add(60).unwrap();
        first.received();
        let mut second = uploads.begin(Client::Unknown).unwrap();
        second.bytes().add(40).unwrap();
        // Two reservations share the two seconds that one is assumed to last.
        assert_eq!(second.bytes().add(1), Err(Seconds::new(1)));
        assert_eq!((metrics.uploads.get(), metrics.upload_bytes.get()), (1, 100));
        // Of which jobs may hold half.
        assert!(uploads.keep_for_job(&mut first).is_ok());
        assert!(matches!(
            uploads.keep_for_job(&mut second),
            Err(ServerError::UploadMemory { retry_after, .. }) if retry_after == soon
        ));
        drop(first);
        assert!(uploads.keep_for_job(&mut second).is_ok());
        second.bytes().add(60).unwrap();
        drop(second);
        assert_eq!((metrics.uploads.get(), metrics.upload_bytes.get()), (0, 0));
    }
}
