//! Places for connections. Where there is none for one more, the connection that has been without a
//! request for longest gives way: idle ones keep nobody out.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use prometheus_client::metrics::gauge::Gauge;
use tokio::time::sleep_until;
use tokio_util::sync::CancellationToken;

use crate::server::{
    config::Limits,
    layers::client::{Client, most_frequent},
};

/// Connections beyond all places, for probes only.
const SPARE: usize = 32;

/// A bounded number of connections, of which one address has its share.
#[derive(Debug)]
pub(super) struct Places {
    most: usize,
    share: usize,
    gauge: Gauge,
    // Held only to put, to take out or to choose one.
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    next: u64,
    open: HashMap<u64, Open>,
}

#[derive(Debug)]
struct Open {
    client: Client,
    spare: bool,
    requests: usize,
    idle_since: Instant,
    displaced: CancellationToken,
}

/// The place of one connection.
#[derive(Debug)]
pub(super) struct Place {
    of: Arc<Places>,
    number: u64,
    /// Whether it is one beyond all places, for probes only.
    pub(super) spare: bool,
    displaced: CancellationToken,
    /// Requests that have begun, and that have ended.
    begun: AtomicU64,
    ended: AtomicU64,
}

/// A request in progress on a connection.
#[derive(Debug)]
pub(super) struct InProgress(Arc<Place>);

impl Places {
    pub(super) fn new(limits: &Limits, gauge: Gauge) -> Arc<Self> {
        let most = limits.max_connections.get();
        let share = limits.share_of(most as u64) as usize;
        Arc::new(Self { most, share, gauge, state: Mutex::default() })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for one more connection. There always is one: that of an idle connection, or, where
    /// all are busy, a spare one.
    pub(super) fn enter(self: &Arc<Self>, client: Client) -> Arc<Place> {
        let mut state = self.state();
        let full = match state.regular(Some(client)).count() >= self.share {
            true => Some(client),
            false if state.regular(None).count() < self.most => None,
            false => most_frequent(state.regular(None).map(|(_, open)| open.client)),
        };
        let spare = full.is_some_and(|full| !state.displace_idle(full));
        if spare {
            state.limit_spare();
        }
        let (number, displaced) = (state.next, CancellationToken::new());
        state.next += 1;
        let idle_since = Instant::now();
        let open = Open { client, spare, requests: 0, idle_since, displaced: displaced.clone() };
        state.open.insert(number, open);
        self.gauge.set(state.open.len() as i64);
        let (begun, ended) = (AtomicU64::new(0), AtomicU64::new(0));
        Arc::new(Place { of: Arc::clone(self), number, spare, displaced, begun, ended })
    }
}

impl State {
    /// Connections that are not spare, of one client or of all.
    fn regular(&self, of: Option<Client>) -> impl Iterator<Item = (&u64, &Open)> {
        let open = self.open.iter().filter(|(_, open)| !open.spare);
        open.filter(move |(_, open)| of.is_none_or(|client| open.client == client))
    }

    /// Ends the client's connection that has been idle for longest; false if all are busy.
    fn displace_idle(&mut self, client: Client) -> bool {
        let idle = self.regular(Some(client)).filter(|(_, open)| open.requests == 0);
        let longest = idle.min_by_key(|(_, open)| open.idle_since).map(|(number, _)| *number);
        longest.is_some_and(|number| self.displace(number))
    }

    /// Makes room for one more spare connection: probes are short.
    fn limit_spare(&mut self) {
        let spare = || self.open.iter().filter(|(_, open)| open.spare).map(|(number, _)| *number);
        if spare().count() >= SPARE
            && let Some(oldest) = spare().min()
        {
            self.displace(oldest);
        }
    }

    fn displace(&mut self, number: u64) -> bool {
        let open = self.open.remove(&number);
        open.is_some_and(|open| {
            open.displaced.cancel();
            true
        })
    }
}

impl Place {
    /// A request begins.
    pub(super) fn request(self: &Arc<Self>) -> InProgress {
        self.begun.fetch_add(1, Ordering::SeqCst);
        if let Some(open) = self.of.state().open.get_mut(&self.number) {
            open.requests += 1;
        }
        InProgress(Arc::clone(self))
    }

    /// How many requests have begun, and whether none of them is in progress.
    pub(super) fn requests(&self) -> (u64, bool) {
        let ended = self.ended.load(Ordering::SeqCst);
        let begun = self.begun.load(Ordering::SeqCst);
        (begun, begun == ended)
    }

    /// Waits until the connection must give way to another.
    pub(super) async fn displaced(&self) {
        self.displaced.cancelled().await;
    }

    /// Waits until there has been no request for `time`.
    pub(super) async fn idle_for(&self, time: Duration) {
        loop {
            let now = Instant::now();
            let until = match self.of.state().open.get(&self.number) {
                Some(open) if open.requests == 0 => open.idle_since + time,
                Some(_) => now + time,
                None => return,
            };
            if until <= now {
                return;
            }
            sleep_until(until.into()).await;
        }
    }
}

impl Drop for InProgress {
    fn drop(&mut self) {
        let Self(place) = self;
        place.ended.fetch_add(1, Ordering::SeqCst);
        if let Some(open) = place.of.state().open.get_mut(&place.number) {
            open.requests -= 1;
            open.idle_since = Instant::now();
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut state = self.of.state();
        state.open.remove(&self.number);
        self.of.gauge.set(state.open.len() as i64);
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;

    const MANY: Client = Client::Key(0);
    const FEW: Client = Client::Key(1);

    fn places(most: usize) -> Arc<Places> {
        let max_connections = NonZeroUsize::new(most).unwrap();
        let limits = Limits { max_connections, ..Limits::default() };
        Places::new(&limits, Gauge::default())
    }

    fn is_displaced(place: &Place) -> bool {
        place.displaced.is_cancelled()
    }

    #[test]
    fn the_longest_idle_of_who_has_the_most_gives_way() {
        let places = places(4);
        let many: Vec<_> = (0..3).map(|_| places.enter(MANY)).collect();
        let busy = many[0].request();
        // Its share is three of four.
        let fourth = places.enter(MANY);
        assert!(is_displaced(&many[1]) && !fourth.spare);
        let first = places.enter(FEW);
        let second = places.enter(FEW);
        assert!(is_displaced(&many[2]) && !is_displaced(&first) && !is_displaced(&second));
        drop(busy);
        let third = places.enter(FEW);
        assert!(!is_displaced(&many[0]) || !is_displaced(&fourth) || !is_displaced(&first));
        assert!(!third.spare);
    }

    #[test]
    fn where_all_are_busy_there_are_spare_ones() {
        let places = places(1);
        let first = places.enter(MANY);
        let busy = first.request();
        let spare: Vec<_> = (0..=SPARE).map(|_| places.enter(FEW)).collect();
        assert!(spare.iter().all(|place| place.spare) && !is_displaced(&first));
        assert!(is_displaced(&spare[0]) && !is_displaced(&spare[1]));
        drop((busy, first));
        assert!(!places.enter(FEW).spare);
        drop(spare);
        assert!(places.state().open.is_empty());
    }

    #[tokio::test]
    async fn a_connection_is_idle_from_its_last_request_on() {
        let time = Duration::from_millis(50);
        let place = places(1).enter(MANY);
        let busy = place.request();
        assert!(tokio::time::timeout(2 * time, place.idle_for(time)).await.is_err());
        drop(busy);
        let started = Instant::now();
        place.idle_for(time).await;
        assert!(started.elapsed() >= time);
    }
}
