//! A bounded amount of something: places, bytes, seconds of audio. First come, first served.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

use prometheus_client::metrics::gauge::Gauge;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::server::config::Seconds;

/// Hold times that the median is taken of: enough to be steady, few enough to follow a change.
const REMEMBERED: usize = 64;
/// The hold time that is assumed before any was measured.
const FIRST_GUESS: Duration = Duration::from_secs(2);

/// A bounded amount of something.
#[derive(Debug)]
pub(crate) struct Budget {
    units: Arc<Semaphore>,
    capacity: usize,
    ledger: Arc<Ledger>,
}

/// What a [`Budget`] and its reservations share.
#[derive(Debug)]
struct Ledger {
    gauge: Gauge,
    reservations: AtomicU32,
    // Held only to push or copy a few numbers, never over an await.
    hold_times: Mutex<VecDeque<Duration>>,
}

impl Ledger {
    fn median_hold_time(&self) -> Duration {
        let times = self.hold_times.lock();
        let mut times = Vec::from(times.unwrap_or_else(PoisonError::into_inner).clone());
        times.sort_unstable();
        times.get(times.len() / 2).copied().unwrap_or(FIRST_GUESS)
    }

    fn remember(&self, time: Duration) {
        let times = self.hold_times.lock();
        let mut times = times.unwrap_or_else(PoisonError::into_inner);
        if times.len() == REMEMBERED {
            times.pop_front();
        }
        times.push_back(time);
    }

    /// When the `ahead`th reservation from now probably ends.
    fn retry_after(&self, ahead: usize) -> Seconds {
        let ahead = u32::try_from(ahead).unwrap_or(u32::MAX);
        let reservations = self.reservations.load(Ordering::SeqCst).max(1);
        Seconds(self.median_hold_time().saturating_mul(ahead) / reservations)
    }
}

impl Budget {
    /// A budget of `capacity` units; `gauge` follows how many are reserved.
    pub(crate) fn new(capacity: u64, gauge: Gauge) -> Self {
        let capacity = usize::try_from(capacity).unwrap_or(usize::MAX);
        let capacity = capacity.min(Semaphore::MAX_PERMITS);
        Self {
            units: Arc::new(Semaphore::new(capacity)),
            capacity,
            ledger: Arc::new(Ledger {
                gauge,
                reservations: AtomicU32::new(0),
                hold_times: Mutex::default(),
            }),
        }
    }

    /// A budget that no metric shows.
    pub(crate) fn unnamed(capacity: u64) -> Self {
        Self::new(capacity, Gauge::default())
    }

    /// Reserves `units`, waiting for them if need be. Requests above the capacity are clamped to
    /// it.
    pub(crate) async fn reserve(&self, units: u64) -> Reservation {
        let permit = Arc::clone(&self.units).acquire_many_owned(self.clamp(units));
        #[expect(clippy::expect_used, reason = "a budget never closes its semaphore")]
        let permit = permit.await.expect("the semaphore is open");
        self.reservation(permit)
    }

    /// Reserves `units` if that many are left.
    pub(crate) fn try_reserve(&self, units: u64) -> Option<Reservation> {
        let units = u32::try_from(units).ok()?;
        let permit = Arc::clone(&self.units).try_acquire_many_owned(units);
        Some(self.reservation(permit.ok()?))
    }

    /// As many units as there are in all, where `units` are more.
    pub(crate) fn clamp(&self, units: u64) -> u32 {
        let capacity = u32::try_from(self.capacity).unwrap_or(u32::MAX);
        u32::try_from(units).unwrap_or(u32::MAX).min(capacity)
    }

    fn reservation(&self, permit: OwnedSemaphorePermit) -> Reservation {
        let ledger = Arc::clone(&self.ledger);
        ledger.reservations.fetch_add(1, Ordering::SeqCst);
        ledger.gauge.inc_by(gauged(permit.num_permits()));
        Reservation { permit, ledger, since: Instant::now(), measured: false }
    }

    pub(crate) fn capacity(&self) -> usize {
        self.capacity
    }

    pub(crate) fn reserved(&self) -> usize {
        self.capacity.saturating_sub(self.units.available_permits())
    }

    pub(crate) fn is_exhausted(&self) -> bool {
        self.units.available_permits() == 0
    }

    /// When a new reservation probably succeeds with `ahead` others to be served first: the median
    /// hold time, shared by all reservations (RELIABILITY, defence 6).
    pub(crate) fn retry_after(&self, ahead: usize) -> Seconds {
        self.ledger.retry_after(ahead)
    }
}

/// Units of a [`Budget`], given back on drop.
#[derive(Debug)]
pub(crate) struct Reservation {
    permit: OwnedSemaphorePermit,
    ledger: Arc<Ledger>,
    since: Instant,
    measured: bool,
}

impl Reservation {
    pub(crate) fn units(&self) -> usize {
        self.permit.num_permits()
    }

    /// Adds `units`; false if the budget has not that many left.
    pub(crate) fn try_grow(&mut self, units: usize) -> bool {
        let total = self.units().saturating_add(units);
        let (Ok(_), Ok(units)) = (u32::try_from(total), u32::try_from(units)) else {
            return false;
        };
        let all = Arc::clone(self.permit.semaphore());
        let Ok(more) = all.try_acquire_many_owned(units) else {
            return false;
        };
        self.ledger.gauge.inc_by(gauged(more.num_permits()));
        self.permit.merge(more);
        true
    }

    /// Gives back all but `units`.
    pub(crate) fn shrink_to(&mut self, units: u64) {
        let kept = usize::try_from(units).unwrap_or(usize::MAX);
        let surplus = self.units().saturating_sub(kept);
        if let Some(surplus) = self.permit.split(surplus) {
            self.ledger.gauge.dec_by(gauged(surplus.num_permits()));
        }
    }

    /// Lets the time until the end of this reservation count among the hold times. Only work that
    /// was done is counted: a refusal after a millisecond says nothing about how long others take.
    pub(crate) fn measure(&mut self) {
        self.measured = true;
    }

    /// When the next reservation probably ends.
    pub(crate) fn retry_after(&self) -> Seconds {
        self.ledger.retry_after(1)
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.ledger.gauge.dec_by(gauged(self.units()));
        self.ledger.reservations.fetch_sub(1, Ordering::SeqCst);
        if self.measured {
            self.ledger.remember(self.since.elapsed());
        }
    }
}

fn gauged(units: usize) -> i64 {
    i64::try_from(units).unwrap_or(i64::MAX)
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
    async fn a_reservation_waits_until_enough_units_are_given_back() {
        let gauge = Gauge::default();
        let budget = Budget::new(100, gauge.clone());
        let mut first = budget.reserve(1_000).await;
        assert_eq!(gauge.get(), 100);
        assert!(budget.is_exhausted() && budget.try_reserve(1).is_none());
        let mut second = pin!(budget.reserve(30));
        let mut context = Context::from_waker(Waker::noop());
        assert!(second.as_mut().poll(&mut context).is_pending());
        first.shrink_to(70);
        let second = second.await;
        assert_eq!((gauge.get(), budget.reserved()), (100, 100));
        drop(first);
        drop(second);
        assert_eq!(gauge.get(), 0);
    }

    #[test]
    fn a_reservation_grows_while_there_are_units() {
        let gauge = Gauge::default();
        let budget = Budget::new(10, gauge.clone());
        let mut grown = budget.try_reserve(0).unwrap();
        assert!(grown.try_grow(6) && grown.try_grow(4) && !grown.try_grow(1));
        assert!(!grown.try_grow(usize::MAX));
        assert_eq!((grown.units(), gauge.get()), (10, 10));
        drop(grown);
        assert_eq!((budget.reserved(), gauge.get()), (0, 0));
    }

    #[test]
    fn retry_after_is_the_median_hold_time_shared_by_all_reservations() {
        let budget = Budget::unnamed(4);
        for _ in 0..=REMEMBERED {
            drop(budget.try_reserve(1).unwrap());
        }
        assert_eq!(budget.retry_after(1), Seconds(FIRST_GUESS), "none was measured");
        for seconds in [1, 100, 6, 7, 2] {
            budget.ledger.remember(Duration::from_secs(seconds));
        }
        let mut held: Vec<_> = (0..4).filter_map(|_| budget.try_reserve(1)).collect();
        assert_eq!(held.len(), 4);
        assert_eq!(budget.retry_after(32), Seconds::new(32 * 6 / 4));
        assert_eq!(budget.retry_after(1).retry_after(), 2);
        held.clear();
        for _ in 0..=REMEMBERED {
            budget.try_reserve(1).unwrap().measure();
        }
        assert_eq!(budget.ledger.hold_times.lock().unwrap().len(), REMEMBERED);
    }
}
