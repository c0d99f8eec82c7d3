//! Who may work now, who waits, and who is told to come back later.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tracing::Instrument;

use super::{
    config::{Limits, Seconds},
    error::ServerError,
    metrics::{Counted, SharedMetrics},
};

/// Service times that the median is taken of: enough to be steady, few enough to follow a change.
const REMEMBERED: usize = 64;
/// What one request is taken to last before any has finished.
const FIRST_GUESS: Duration = Duration::from_secs(2);

/// A bounded number of running requests and of waiting ones.
#[derive(Debug)]
pub(crate) struct Admission {
    slots: Arc<Semaphore>,
    running: usize,
    waiting: AtomicUsize,
    queue: usize,
    metrics: SharedMetrics,
    // Held only to push or copy a few numbers, never over an await.
    served: Mutex<VecDeque<Duration>>,
}

impl Admission {
    pub(crate) fn new(limits: &Limits, metrics: SharedMetrics) -> Arc<Self> {
        let running = limits.max_concurrent_requests.get();
        Arc::new(Self {
            slots: Arc::new(Semaphore::new(running)),
            running,
            waiting: AtomicUsize::new(0),
            queue: limits.queue,
            metrics,
            served: Mutex::new(VecDeque::with_capacity(REMEMBERED)),
        })
    }

    /// Refuses at once who would find the line full: nothing is read of a body that nobody can use.
    ///
    /// # Errors
    /// [`ServerError::QueueFull`].
    pub(crate) fn check_room(&self) -> Result<(), ServerError> {
        let full = self.slots.available_permits() == 0
            && self.waiting.load(Ordering::SeqCst) >= self.queue;
        match full {
            true => Err(self.full()),
            false => Ok(()),
        }
    }

    /// Waits for a place to work in, first come first served.
    ///
    /// # Errors
    /// [`ServerError::QueueFull`] when as many wait already as may.
    pub(crate) async fn admit(self: &Arc<Self>) -> Result<Permit, ServerError> {
        if let Some(permit) = self.admit_now() {
            return Ok(permit);
        }
        let _place = self.wait_in_line()?;
        let _waiting = Counted::new(&self.metrics.queue_waiting);
        self.admit_patient().await
    }

    /// [`Self::admit`], in a span of its own.
    pub(crate) async fn admit_traced(self: &Arc<Self>) -> Result<Permit, ServerError> {
        let span = tracing::info_span!("stage", otel.name = "queue");
        self.admit().instrument(span).await
    }

    /// Waits as [`Self::admit`] does, in a line that is bounded elsewhere.
    ///
    /// # Errors
    /// None that is known; the semaphore is never closed.
    pub(crate) async fn admit_patient(self: &Arc<Self>) -> Result<Permit, ServerError> {
        if let Some(permit) = self.admit_now() {
            return Ok(permit);
        }
        let asked = Instant::now();
        let slot = Arc::clone(&self.slots).acquire_owned().await?;
        Ok(self.permit(slot, asked.elapsed()))
    }

    fn admit_now(self: &Arc<Self>) -> Option<Permit> {
        let slot = Arc::clone(&self.slots).try_acquire_owned().ok()?;
        Some(self.permit(slot, Duration::ZERO))
    }

    fn permit(self: &Arc<Self>, slot: OwnedSemaphorePermit, waited: Duration) -> Permit {
        self.metrics.waited(waited);
        Permit {
            _running: Counted::new(&self.metrics.running),
            admission: Arc::clone(self),
            waited,
            since: Instant::now(),
            _slot: slot,
        }
    }

    fn wait_in_line(&self) -> Result<PlaceInLine<'_>, ServerError> {
        self.waiting
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |waiting| {
                (waiting < self.queue).then_some(waiting + 1)
            })
            .map(|_| PlaceInLine {
                waiting: &self.waiting,
            })
            .map_err(|_| self.full())
    }

    fn full(&self) -> ServerError {
        ServerError::QueueFull {
            queue: self.queue,
            retry_after: self.retry_after(),
        }
    }

    /// When a new request would probably find a place: the line's length times the median service
    /// time, shared by all that work at the same time (RELIABILITY, defence 6).
    pub(crate) fn retry_after(&self) -> Seconds {
        let ahead = u32::try_from(self.waiting.load(Ordering::SeqCst).max(1)).unwrap_or(u32::MAX);
        let running = u32::try_from(self.running).unwrap_or(u32::MAX);
        Seconds(self.median_service_time().saturating_mul(ahead) / running)
    }

    fn median_service_time(&self) -> Duration {
        let mut served: Vec<Duration> = {
            let served = self.served.lock().unwrap_or_else(PoisonError::into_inner);
            served.iter().copied().collect()
        };
        served.sort_unstable();
        served.get(served.len() / 2).copied().unwrap_or(FIRST_GUESS)
    }

    fn remember(&self, service: Duration) {
        let mut served = self.served.lock().unwrap_or_else(PoisonError::into_inner);
        if served.len() == REMEMBERED {
            served.pop_front();
        }
        served.push_back(service);
    }
}

/// Counts one waiting request for as long as it lives: a client that leaves gives its place up.
struct PlaceInLine<'admission> {
    waiting: &'admission AtomicUsize,
}

impl Drop for PlaceInLine<'_> {
    fn drop(&mut self) {
        self.waiting.fetch_sub(1, Ordering::SeqCst);
    }
}

/// The right to work. It goes with the work to its blocking thread, so that work whose client has
/// gone still counts until it has really stopped.
#[derive(Debug)]
pub(crate) struct Permit {
    admission: Arc<Admission>,
    /// Time spent waiting for it.
    pub(crate) waited: Duration,
    since: Instant,
    _running: Counted,
    _slot: OwnedSemaphorePermit,
}

impl Permit {
    /// Gives the permit back after a dance. Only those are remembered: a refusal after a millisecond
    /// says nothing about how long the line takes.
    pub(crate) fn danced(self) {
        self.admission.remember(self.since.elapsed());
    }
}

#[cfg(test)]
mod tests {
    use std::{
        future::Future,
        num::NonZeroUsize,
        task::{Context, Waker},
    };

    use super::*;

    fn admission(running: usize, queue: usize) -> Arc<Admission> {
        let limits = Limits {
            max_concurrent_requests: NonZeroUsize::new(running).unwrap(),
            queue,
            ..Limits::default()
        };
        Admission::new(&limits, SharedMetrics::default())
    }

    #[tokio::test]
    async fn the_line_is_bounded_and_moves_on() {
        let admission = admission(1, 1);
        let first = admission.admit().await.unwrap();
        let second = tokio::spawn({
            let admission = Arc::clone(&admission);
            async move { admission.admit().await.map(|permit| permit.waited) }
        });
        while admission.waiting.load(Ordering::SeqCst) == 0 {
            tokio::task::yield_now().await;
        }
        assert!(matches!(
            admission.admit().await,
            Err(ServerError::QueueFull { queue: 1, .. })
        ));
        drop(first);
        assert!(second.await.unwrap().is_ok());
        assert_eq!(admission.waiting.load(Ordering::SeqCst), 0);
        assert_eq!(admission.slots.available_permits(), 1);
    }

    #[tokio::test]
    async fn a_client_that_leaves_gives_its_place_up() {
        let admission = admission(1, 1);
        let _first = admission.admit().await.unwrap();
        let mut waiting = Box::pin(admission.admit());
        let mut context = Context::from_waker(Waker::noop());
        assert!(waiting.as_mut().poll(&mut context).is_pending());
        assert_eq!(admission.waiting.load(Ordering::SeqCst), 1);
        drop(waiting);
        assert_eq!(admission.waiting.load(Ordering::SeqCst), 0);
    }

    #[tokio::test]
    async fn only_dances_tell_how_long_the_line_takes() {
        let admission = admission(1, 1);
        for _ in 0..REMEMBERED {
            drop(admission.admit().await.unwrap());
        }
        assert_eq!(admission.median_service_time(), FIRST_GUESS);
        admission.admit().await.unwrap().danced();
        assert_eq!(admission.served.lock().unwrap().len(), 1);
        assert_eq!(admission.slots.available_permits(), 1);
    }

    #[test]
    fn retry_after_is_line_times_median_over_places() {
        let admission = admission(4, 32);
        for seconds in [1, 100, 6, 7, 2] {
            admission.remember(Duration::from_secs(seconds));
        }
        admission.waiting.store(32, Ordering::SeqCst);
        assert_eq!(admission.retry_after(), Seconds::new(32 * 6 / 4));
        admission.waiting.store(0, Ordering::SeqCst);
        assert_eq!(admission.retry_after().retry_after(), 2);
    }
}
