//! Running requests and waiting ones; one more is told to come back later.

use std::time::{Duration, Instant};

use tracing::Instrument;

use super::budget::{Budget, Reservation};
use crate::server::{
    config::{Limits, Seconds},
    error::ServerError,
    metrics::SharedMetrics,
};

/// A bounded number of running requests, and a bounded queue.
#[derive(Debug)]
pub(crate) struct Admission {
    workers: Budget,
    queue: Budget,
    metrics: SharedMetrics,
}

impl Admission {
    pub(crate) fn new(limits: &Limits, metrics: SharedMetrics) -> Self {
        let running = limits.max_concurrent_requests.get() as u64;
        Self {
            workers: Budget::new(running, metrics.running.clone()),
            queue: Budget::new(limits.queue as u64, metrics.queue_waiting.clone()),
            metrics,
        }
    }

    /// Refuses a request that would find the queue full, before its body is read.
    ///
    /// # Errors
    /// [`ServerError::QueueFull`].
    pub(crate) fn check_room(&self) -> Result<(), ServerError> {
        match self.is_full() {
            true => Err(self.queue_full()),
            false => Ok(()),
        }
    }

    /// Whether all workers are busy and the queue is full.
    pub(crate) fn is_full(&self) -> bool {
        self.workers.is_exhausted() && self.queue.is_exhausted()
    }

    /// Waits in the queue for a worker, in a span of its own.
    ///
    /// # Errors
    /// [`ServerError::QueueFull`].
    pub(crate) async fn admit(&self) -> Result<Permit, ServerError> {
        let span = tracing::info_span!("stage", otel.name = "queue");
        let admitted = async {
            if let Some(worker) = self.workers.try_reserve(1) {
                return Ok(self.permit(worker, Duration::ZERO));
            }
            let _place = self.queue.try_reserve(1).ok_or_else(|| self.queue_full())?;
            Ok(self.admit_unqueued().await)
        };
        admitted.instrument(span).await
    }

    /// Waits for a worker without a place in the queue, for callers that are bounded elsewhere.
    pub(crate) async fn admit_unqueued(&self) -> Permit {
        let asked = Instant::now();
        let worker = self.workers.reserve(1).await;
        self.permit(worker, asked.elapsed())
    }

    fn permit(&self, worker: Reservation, waited: Duration) -> Permit {
        self.metrics.waited(waited);
        Permit { waited, worker }
    }

    fn queue_full(&self) -> ServerError {
        ServerError::QueueFull { queue: self.queue.capacity(), retry_after: self.retry_after() }
    }

    /// When a new request would probably find a place: the length of the queue times the median
    /// service time, shared by all workers.
    pub(crate) fn retry_after(&self) -> Seconds {
        self.workers.retry_after(self.queue.reserved().max(1))
    }
}

/// The right to work. It goes with the work to its blocking thread, so that work whose client has
/// disconnected still counts until it has really stopped.
#[derive(Debug)]
pub(crate) struct Permit {
    /// Time spent waiting for it.
    pub(crate) waited: Duration,
    worker: Reservation,
}

impl Permit {
    /// Gives the permit back after a generation, whose time counts as a service time.
    pub(crate) fn complete(mut self) {
        self.worker.measure();
    }
}

#[cfg(test)]
mod tests {
    use std::{
        future::Future,
        num::NonZeroUsize,
        sync::Arc,
        task::{Context, Waker},
    };

    use super::*;

    fn admission() -> Arc<Admission> {
        let limits =
            Limits { max_concurrent_requests: NonZeroUsize::MIN, queue: 1, ..Limits::default() };
        Arc::new(Admission::new(&limits, SharedMetrics::default()))
    }

    #[tokio::test]
    async fn the_queue_is_bounded_and_moves_on() {
        let admission = admission();
        let first = admission.admit().await.unwrap();
        let second = tokio::spawn({
            let admission = Arc::clone(&admission);
            async move { admission.admit().await.map(|permit| permit.waited) }
        });
        while admission.queue.reserved() == 0 {
            tokio::task::yield_now().await;
        }
        assert!(admission.check_room().is_err());
        assert!(matches!(admission.admit().await, Err(ServerError::QueueFull { queue: 1, .. })));
        drop(first);
        assert!(second.await.unwrap().is_ok());
        assert_eq!(admission.queue.reserved(), 0);
        assert_eq!(admission.workers.reserved(), 0);
    }

    #[tokio::test]
    async fn a_client_that_disconnects_leaves_the_queue() {
        let admission = admission();
        let _first = admission.admit().await.unwrap();
        let mut waiting = Box::pin(admission.admit());
        let mut context = Context::from_waker(Waker::noop());
        assert!(waiting.as_mut().poll(&mut context).is_pending());
        assert_eq!(admission.queue.reserved(), 1);
        drop(waiting);
        assert_eq!(admission.queue.reserved(), 0);
    }

    #[tokio::test]
    async fn only_generations_tell_the_service_time() {
        let admission = admission();
        for _ in 0..3 {
            drop(admission.admit().await.unwrap());
        }
        assert_eq!(admission.retry_after(), Seconds::new(2));
        admission.admit().await.unwrap().complete();
        assert!(admission.retry_after() < Seconds::new(1));
    }
}
