//! Bodies in transfer: how many at once, and how many bytes of them are held.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::Ordering};

use super::{
    budget::{Budget, Reservation},
    transfers::{Displaced, Transfer, Transfers},
};
use crate::server::{
    config::{Limits, Seconds},
    error::ServerError,
    layers::client::Client,
    metrics::Metrics,
};

/// A bounded number of bodies, and of bytes of them.
#[derive(Debug)]
pub(crate) struct Uploads {
    bodies: Arc<Transfers>,
    bytes: Budget,
}

impl Uploads {
    pub(crate) fn new(limits: &Limits, metrics: &Metrics) -> Self {
        let (most, memory) = (limits.max_uploads.get(), limits.upload_memory.0);
        let bodies = limits.share_of(most as u64) as usize;
        // Room for the largest file in any case.
        let share = limits.share_of(memory).max(limits.largest_body().0);
        Self {
            bodies: Transfers::new(most, bodies, metrics.uploads.clone()),
            bytes: Budget::shared(memory, share, metrics.upload_bytes.clone()),
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
        Ok(UploadReservation { body: Some(body), bytes: HeldBytes(Arc::new(Mutex::new(bytes))) })
    }
}

/// The right to receive one body, and to hold it until it is decoded.
#[derive(Debug)]
pub(crate) struct UploadReservation {
    body: Option<Transfer>,
    bytes: HeldBytes,
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
    use crate::server::config::ByteSize;

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
        let second = uploads.begin(Client::Unknown).unwrap();
        second.bytes().add(40).unwrap();
        // Two reservations share the two seconds that one is assumed to last.
        assert_eq!(second.bytes().add(1), Err(Seconds::new(1)));
        assert_eq!((metrics.uploads.get(), metrics.upload_bytes.get()), (1, 100));
        drop(first);
        second.bytes().add(60).unwrap();
        drop(second);
        assert_eq!((metrics.uploads.get(), metrics.upload_bytes.get()), (0, 0));
    }
}
