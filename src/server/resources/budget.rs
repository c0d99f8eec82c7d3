//! A bounded amount of something: bytes, seconds of audio. First come, first served, and no client
//! takes more than its share.

use std::{
    collections::{HashMap, VecDeque},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

use prometheus_client::metrics::gauge::Gauge;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::server::{config::Seconds, layers::client::Client};

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

/// Why nothing was reserved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Short {
    /// The client holds its share already.
    Share,
    /// There is not so much left of all.
    All,
}

/// What a [`Budget`] and its reservations share.
#[derive(Debug)]
struct Ledger {
    gauge: Gauge,
    reservations: AtomicU32,
    /// Units that one client may hold.
    share: usize,
    // Held only to add to or to take from a number, never over an await.
    held: Mutex<HashMap<Client, usize>>,
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

    /// Counts `units` as the client's; false where its share is not large enough.
    fn take(&self, client: Client, units: usize) -> bool {
        if client == Client::Unknown {
            return true;
        }
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let holds = held.get(&client).copied().unwrap_or(0).saturating_add(units);
        if holds > self.share {
            return false;
        }
        held.insert(client, holds);
        true
    }

    fn give_back(&self, client: Client, units: usize) {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(holds) = held.get_mut(&client) {
            *holds = holds.saturating_sub(units);
            if *holds == 0 {
                held.remove(&client);
            }
        }
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
        Self::shared(capacity, u64::MAX, gauge)
    }

    /// A budget of `capacity` units, of which one client may hold `share`.
    pub(crate) fn shared(capacity: u64, share: u64, gauge: Gauge) -> Self {
        let capacity = usize::try_from(capacity).unwrap_or(usize::MAX);
        let capacity = capacity.min(Semaphore::MAX_PERMITS);
        Self {
            units: Arc::new(Semaphore::new(capacity)),
            capacity,
            ledger: Arc::new(Ledger {
                gauge,
                reservations: AtomicU32::new(0),
                share: usize::try_from(share).unwrap_or(usize::MAX),
                held: Mutex::default(),
                hold_times: Mutex::default(),
            }),
        }
    }

    /// Reserves `units`, waiting for them if need be. Requests above the capacity are clamped to
    /// it.
    pub(crate) async fn reserve(&self, units: u64) -> Reservation {
        let permit = Arc::clone(&self.units).acquire_many_owned(self.clamp(units));
        #[expect(clippy::expect_used, reason = "a budget never closes its semaphore")]
        let permit = permit.await.expect("the semaphore is open");
        self.reservation(permit, Client::Unknown)
    }

    /// Reserves `units` of the client's share, waiting for others if need be. Where they are more
    /// than its share, all of it.
    ///
    /// # Errors
    /// [`Short::Share`] at once.
    pub(crate) async fn reserve_for(
        &self,
        client: Client,
        units: u64,
    ) -> Result<Reservation, Short> {
        let share = match client {
            Client::Unknown => u64::MAX,
            _ => u64::try_from(self.ledger.share).unwrap_or(u64::MAX),
        };
        let mut taken = Taken::new(&self.ledger, client, self.clamp(units.min(share)) as usize)?;
        let mut reservation = self.reserve(taken.units as u64).await;
        reservation.client = taken.keep();
        Ok(reservation)
    }

    /// Reserves `units` of the client's share if that many are left.
    ///
    /// # Errors
    /// [`Short`] says of what there are not enough.
    pub(crate) fn try_reserve_for(&self, client: Client, units: u64) -> Result<Reservation, Short> {
        let units = u32::try_from(units).map_err(|_| Short::All)?;
        let mut taken = Taken::new(&self.ledger, client, units as usize)?;
        let permit = Arc::clone(&self.units).try_acquire_many_owned(units);
        Ok(self.reservation(permit.map_err(|_| Short::All)?, taken.keep()))
    }

    /// Whether anything is left of the client's share.
    pub(crate) fn is_share_left(&self, client: Client) -> bool {
        Taken::new(&self.ledger, client, 1).is_ok()
    }

    /// Whether the client could reserve `units` now.
    pub(crate) fn has_room_for(&self, client: Client, units: usize) -> bool {
        let within = Taken::new(&self.ledger, client, units).is_ok();
        within && self.units.available_permits() >= units
    }

    /// As many units as there are in all, where `units` are more.
    pub(crate) fn clamp(&self, units: u64) -> u32 {
        let capacity = u32::try_from(self.capacity).unwrap_or(u32::MAX);
        u32::try_from(units).unwrap_or(u32::MAX).min(capacity)
    }

    fn reservation(&self, permit: OwnedSemaphorePermit, client: Client) -> Reservation {
        let ledger = Arc::clone(&self.ledger);
        ledger.reservations.fetch_add(1, Ordering::SeqCst);
        ledger.gauge.inc_by(gauged(permit.num_permits()));
        Reservation { permit, ledger, client, since: Instant::now(), measured: false }
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
    /// Whose share it is.
    client: Client,
    since: Instant,
    measured: bool,
}

impl Reservation {
    pub(crate) fn units(&self) -> usize {
        self.permit.num_permits()
    }

    /// Adds `units`; false if the budget, or the client's share, has not that many left.
    pub(crate) fn try_grow(&mut self, units: usize) -> bool {
        let total = self.units().saturating_add(units);
        let (Ok(_), Ok(units)) = (u32::try_from(total), u32::try_from(units)) else {
            return false;
        };
        let Ok(mut taken) = Taken::new(&self.ledger, self.client, units as usize) else {
            return false;
        };
        let all = Arc::clone(self.permit.semaphore());
        let Ok(more) = all.try_acquire_many_owned(units) else {
            return false;
        };
        taken.keep();
        self.ledger.gauge.inc_by(gauged(more.num_permits()));
        self.permit.merge(more);
        true
    }

    /// Gives back all but `units`.
    pub(crate) fn shrink_to(&mut self, units: u64) {
        let kept = usize::try_from(units).unwrap_or(usize::MAX);
        let surplus = self.units().saturating_sub(kept);
        if let Some(surplus) = self.permit.split(surplus) {
            self.ledger.give_back(self.client, surplus.num_permits());
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
        self.ledger.give_back(self.client, self.units());
        self.ledger.reservations.fetch_sub(1, Ordering::SeqCst);
        if self.measured {
            self.ledger.remember(self.since.elapsed());
        }
    }
}

/// Units that are counted as a client's, and not kept yet.
struct Taken<'a> {
    ledger: &'a Ledger,
    client: Client,
    units: usize,
}

impl<'a> Taken<'a> {
    fn new(ledger: &'a Ledger, client: Client, units: usize) -> Result<Self, Short> {
        match ledger.take(client, units) {
            true => Ok(Self { ledger, client, units }),
            false => Err(Short::Share),
        }
    }

    fn keep(&mut self) -> Client {
        self.units = 0;
        self.client
    }
}

impl Drop for Taken<'_> {
    fn drop(&mut self) {
        self.ledger.give_back(self.client, self.units);
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

    fn any(budget: &Budget, units: u64) -> Option<Reservation> {
        budget.try_reserve_for(Client::Unknown, units).ok()
    }

    #[tokio::test]
    async fn a_reservation_waits_until_enough_units_are_given_back() {
        let gauge = Gauge::default();
        let budget = Budget::new(100, gauge.clone());
        let mut first = budget.reserve(1_000).await;
        assert_eq!(gauge.get(), 100);
        assert!(budget.is_exhausted() && any(&budget, 1).is_none());
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
        let mut grown = any(&budget, 0).unwrap();
        assert!(grown.try_grow(6) && grown.try_grow(4) && !grown.try_grow(1));
        assert!(!grown.try_grow(usize::MAX));
        assert_eq!((grown.units(), gauge.get()), (10, 10));
        drop(grown);
        assert_eq!((budget.reserved(), gauge.get()), (0, 0));
    }

    #[tokio::test]
    async fn a_client_takes_its_share_and_leaves_the_rest_to_others() {
        let (one, other) = (Client::Key(1), Client::Key(2));
        let budget = Budget::shared(10, 6, Gauge::default());
        let mut first = budget.try_reserve_for(one, 4).unwrap();
        assert_eq!(budget.try_reserve_for(one, 3).unwrap_err(), Short::Share);
        assert_eq!(budget.reserve_for(one, 3).await.unwrap_err(), Short::Share);
        assert!(first.try_grow(2) && !first.try_grow(1));
        assert_eq!(budget.try_reserve_for(other, 5).unwrap_err(), Short::All);
        let second = budget.reserve_for(other, 4).await.unwrap();
        // Who waits counts too, until it no longer waits.
        first.shrink_to(5);
        let mut waiting = Box::pin(budget.reserve_for(other, 2));
        let mut context = Context::from_waker(Waker::noop());
        assert!(waiting.as_mut().poll(&mut context).is_pending());
        assert_eq!(budget.reserve_for(other, 1).await.unwrap_err(), Short::Share);
        drop((waiting, first));
        drop(budget.try_reserve_for(other, 2).unwrap());
        drop(second);
        // More than a share is a share.
        assert_eq!(budget.reserve_for(one, 100).await.unwrap().units(), 6);
        assert!(budget.ledger.held.lock().unwrap().is_empty());
    }

    #[test]
    fn retry_after_is_the_median_hold_time_shared_by_all_reservations() {
        let budget = Budget::new(4, Gauge::default());
        for _ in 0..=REMEMBERED {
            drop(any(&budget, 1).unwrap());
        }
        assert_eq!(budget.retry_after(1), Seconds(FIRST_GUESS), "none was measured");
        for seconds in [1, 100, 6, 7, 2] {
            budget.ledger.remember(Duration::from_secs(seconds));
        }
        let mut held: Vec<_> = (0..4).filter_map(|_| any(&budget, 1)).collect();
        assert_eq!(held.len(), 4);
        assert_eq!(budget.retry_after(32), Seconds::new(32 * 6 / 4));
        assert_eq!(budget.retry_after(1).retry_after(), 2);
        held.clear();
        for _ in 0..=REMEMBERED {
            any(&budget, 1).unwrap().measure();
        }
        assert_eq!(budget.ledger.hold_times.lock().unwrap().len(), REMEMBERED);
    }
}
