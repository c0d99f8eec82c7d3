//! Room that is waited for: seconds of audio in flight, and bytes of answers.

use std::sync::Arc;

use prometheus_client::metrics::gauge::Gauge;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::error::ServerError;

/// A bounded amount of something, first come first served.
#[derive(Debug)]
pub(crate) struct Room {
    units: Arc<Semaphore>,
    all: u32,
    gauge: Option<Gauge>,
}

/// A part of a [`Room`].
#[derive(Debug)]
pub(crate) struct Share {
    permit: OwnedSemaphorePermit,
    gauge: Option<Gauge>,
}

impl Room {
    /// Room for so many units; `gauge` follows how many are taken.
    pub(crate) fn new(units: u64, gauge: Option<Gauge>) -> Self {
        let all = u32::try_from(units).unwrap_or(u32::MAX);
        Self {
            units: Arc::new(Semaphore::new(all as usize)),
            all,
            gauge,
        }
    }

    /// Waits for room. Who wants more than there is gets all of it.
    ///
    /// # Errors
    /// None that is known; semaphores are never closed here.
    pub(crate) async fn share(&self, units: u64) -> Result<Share, ServerError> {
        let units = u32::try_from(units).unwrap_or(u32::MAX).min(self.all);
        let permit = Arc::clone(&self.units).acquire_many_owned(units).await?;
        if let Some(gauge) = &self.gauge {
            gauge.inc_by(i64::from(units));
        }
        Ok(Share {
            permit,
            gauge: self.gauge.clone(),
        })
    }
}

impl Share {
    /// Gives back what goes beyond `units`.
    pub(crate) fn keep(&mut self, units: u64) {
        let kept = usize::try_from(units).unwrap_or(usize::MAX);
        let surplus = self.permit.num_permits().saturating_sub(kept);
        if let Some(surplus) = self.permit.split(surplus) {
            self.tell(surplus.num_permits());
        }
    }

    fn tell(&self, given_back: usize) {
        if let Some(gauge) = &self.gauge {
            gauge.dec_by(i64::try_from(given_back).unwrap_or(i64::MAX));
        }
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.tell(self.permit.num_permits());
    }
}

#[cfg(test)]
mod tests {
    use std::{
        future::Future,
        pin::pin,
        task::{Context, Waker},
    };

    use super::*;

    #[tokio::test]
    async fn who_finds_no_room_waits_until_some_is_given_back() {
        let gauge = Gauge::default();
        let room = Room::new(100, Some(gauge.clone()));
        let mut first = room.share(1_000).await.unwrap();
        assert_eq!(gauge.get(), 100);
        let mut second = pin!(room.share(30));
        let mut context = Context::from_waker(Waker::noop());
        assert!(second.as_mut().poll(&mut context).is_pending());
        first.keep(70);
        let second = second.await.unwrap();
        assert_eq!(gauge.get(), 100);
        drop(first);
        drop(second);
        assert_eq!(gauge.get(), 0);
    }
}
