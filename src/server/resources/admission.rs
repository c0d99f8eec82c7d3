//! Running requests and waiting ones; one more is told to come back later.

use std::time::Duration;

use tracing::Instrument;

use super::{
    budget::{Budget, Reservation},
    turns::{Stay, Turn, Turns},
};
use crate::server::{
    config::{Limits, Seconds},
    error::ServerError,
    layers::client::Client,
    metrics::SharedMetrics,
};

/// A bounded number of running requests, and a bounded queue. Clients take turns, none takes all
/// workers or all of the queue, and where there are several workers, one may be for short requests.
#[derive(Debug)]
pub(crate) struct Admission {
    turns: Turns,
    /// Follows the turns that are taken, and how long they are held.
    workers: Budget,
    queue: Budget,
    metrics: SharedMetrics,
}

impl Admission {
    /// `serves_short` says whether one of several workers is for short requests.
    pub(crate) fn new(limits: &Limits, serves_short: bool, metrics: SharedMetrics) -> Self {
        let workers = limits.max_concurrent_requests.get();
        let share = limits.share_of(limits.queue as u64);
        let express = usize::from(serves_short && workers > 1);
        let for_all = workers - express;
        Self {
            turns: Turns::new(for_all, limits.share_of(for_all as u64) as usize, express),
            workers: Budget::new(workers as u64, metrics.running.clone()),
            queue: Budget::shared(limits.queue as u64, share, metrics.queue_waiting.clone()),
            metrics,
        }
    }

    /// Refuses a request that would find the queue full, before its body is read.
    ///
    /// # Errors
    /// [`ServerError::QueueFull`].
    pub(crate) fn check_room(&self, client: Client) -> Result<(), ServerError> {
        let full = self.turns.is_full(client, Stay::Short) && !self.queue.has_room_for(client, 1);
        match full {
            true => Err(self.queue_full()),
            false => Ok(()),
        }
    }

    /// Waits in the queue for a worker, in a span of its own.
    ///
    /// # Errors
    /// [`ServerError::QueueFull`].
    pub(crate) async fn admit(&self, client: Client, stay: Stay) -> Result<Permit, ServerError> {
        let span = tracing::info_span!("stage", otel.name = "queue");
        let admitted = async {
            if let Some(turn) = self.turns.try_take(client, stay) {
                return Ok(self.permit(turn, Duration::ZERO).await);
            }
            let place = self.queue.try_reserve_for(client, 1);
            let _place = place.map_err(|_| self.queue_full())?;
            Ok(self.admit_unqueued(client, stay).await)
        };
        admitted.instrument(span).await
    }

    /// Waits for a worker without a place in the queue, for callers that are bounded elsewhere.
    pub(crate) async fn admit_unqueued(&self, client: Client, stay: Stay) -> Permit {
        let (turn, waited) = self.turns.take(client, stay).await;
        self.permit(turn, waited).await
    }

    async fn permit(&self, turn: Turn, waited: Duration) -> Permit {
        self.metrics.waited(waited);
        Permit { waited, worker: self.workers.reserve(1).await, turn }
    }

    fn queue_full(&self) -> ServerError {
        ServerError::QueueFull { queue: self.queue.reserved(), retry_after: self.retry_after() }
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
    // Given back before the turn, so that whose turn comes next finds it.
    worker: Reservation,
    turn: Turn,
}

impl Permit {
    /// Whether it is the worker for short requests.
    pub(crate) fn is_express(&self) -> bool {
        self.turn.is_express
    }

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

    const ANY: Client = Client::Unknown;

    fn admission() -> Arc<Admission> {
        let limits =
            Limits { max_concurrent_requests: NonZeroUsize::MIN, queue: 1, ..Limits::default() };
        Arc::new(Admission::new(&limits, true, SharedMetrics::default()))
    }

    #[tokio::test]
    async fn the_queue_is_bounded_and_moves_on() {
        let admission = admission();
        let first = admission.admit(ANY, Stay::Short).await.unwrap();
        let second = tokio::spawn({
            let admission = Arc::clone(&admission);
            async move { admission.admit(ANY, Stay::Short).await.map(|permit| permit.waited) }
        });
        while admission.queue.reserved() == 0 {
            tokio::task::yield_now().await;
        }
        assert!(admission.check_room(ANY).is_err());
        assert!(matches!(
            admission.admit(ANY, Stay::Short).await,
            Err(ServerError::QueueFull { queue: 1, .. })
        ));
        drop(first);
        assert!(second.await.unwrap().is_ok());
        assert_eq!(admission.queue.reserved(), 0);
        assert_eq!(admission.workers.reserved(), 0);
    }

    #[tokio::test]
    async fn a_client_that_disconnects_leaves_the_queue() {
        let admission = admission();
        let _first = admission.admit(ANY, Stay::Short).await.unwrap();
        let mut waiting = Box::pin(admission.admit(ANY, Stay::Short));
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
            drop(admission.admit(ANY, Stay::Short).await.unwrap());
        }
        assert_eq!(admission.retry_after(), Seconds::new(2));
        admission.admit(ANY, Stay::Short).await.unwrap().complete();
        assert!(admission.retry_after() < Seconds::new(1));
    }
}
