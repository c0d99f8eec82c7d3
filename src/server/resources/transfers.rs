//! Bodies on their way. Where there is no place for one more, the client with the most of them
//! loses its slowest: a body that hardly moves keeps nobody out.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use prometheus_client::metrics::gauge::Gauge;
use tokio_util::sync::CancellationToken;

use crate::server::layers::client::{Client, most_frequent};

/// A body that has begun this shortly ago is not called slow.
const GRACE: Duration = Duration::from_secs(1);

/// A bounded number of bodies on their way.
#[derive(Debug)]
pub(super) struct Transfers {
    most: usize,
    share: usize,
    gauge: Gauge,
    // Held only to put, to take out or to choose one.
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    next: u64,
    bodies: HashMap<u64, Body>,
}

#[derive(Debug)]
struct Body {
    client: Client,
    since: Instant,
    bytes: Arc<AtomicU64>,
    displaced: CancellationToken,
}

impl Body {
    /// Bytes a second, if that can be told already.
    fn rate(&self) -> Option<u64> {
        let age = self.since.elapsed();
        let bytes = self.bytes.load(Ordering::Relaxed) as f64;
        (age >= GRACE).then(|| (bytes / age.as_secs_f64()) as u64)
    }
}

/// The place of one body on its way.
#[derive(Debug)]
pub(super) struct Transfer {
    of: Arc<Transfers>,
    number: u64,
    pub(super) bytes: Arc<AtomicU64>,
    pub(super) displaced: Displaced,
}

/// Triggered when the body must give way.
pub(crate) type Displaced = CancellationToken;

impl Transfers {
    /// `most` bodies, `share` of them of one client.
    pub(super) fn new(most: usize, share: usize, gauge: Gauge) -> Arc<Self> {
        Arc::new(Self { most, share, gauge, state: Mutex::default() })
    }

    pub(super) fn most(&self) -> usize {
        self.most
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for one more body; none where all others are too young to be called slow.
    pub(super) fn begin(self: &Arc<Self>, client: Client) -> Option<Transfer> {
        let mut state = self.state();
        let clients = || state.bodies.values().map(|body| body.client);
        let own = clients().filter(|&of| of == client).count();
        if client != Client::Unknown && own >= self.share {
            state.displace(client)?;
        } else if state.bodies.len() >= self.most {
            let most = most_frequent(clients())?;
            state.displace(most)?;
        }
        self.gauge.set(state.bodies.len() as i64 + 1);
        Some(self.put(&mut state, client))
    }

    fn put(self: &Arc<Self>, state: &mut State, client: Client) -> Transfer {
        let (bytes, displaced) = (Arc::default(), Displaced::new());
        let number = state.next;
        state.next += 1;
        let body = Body {
            client,
            since: Instant::now(),
            bytes: Arc::clone(&bytes),
            displaced: displaced.clone(),
        };
        state.bodies.insert(number, body);
        Transfer { of: Arc::clone(self), number, bytes, displaced }
    }
}

impl State {
    /// Makes the slowest body of `client` give way, if there is one.
    fn displace(&mut self, client: Client) -> Option<()> {
        let bodies = self.bodies.iter().filter(|(_, body)| body.client == client);
        let rates = bodies.filter_map(|(number, body)| Some((body.rate()?, *number)));
        let (_, slowest) = rates.min()?;
        self.bodies.remove(&slowest)?.displaced.cancel();
        Some(())
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        let mut state = self.of.state();
        state.bodies.remove(&self.number);
        self.of.gauge.set(state.bodies.len() as i64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Makes all bodies old enough to be called slow.
    fn age(transfers: &Transfers) {
        for body in transfers.state().bodies.values_mut() {
            body.since = Instant::now().checked_sub(2 * GRACE).unwrap();
        }
    }

    #[test]
    fn the_slowest_of_who_has_the_most_gives_way() {
        let gauge = Gauge::default();
        let transfers = Transfers::new(3, 2, gauge.clone());
        let (many, few) = (Client::Key(0), Client::Key(1));
        let fast = transfers.begin(many).unwrap();
        fast.bytes.store(1_000_000, Ordering::Relaxed);
        let slow = transfers.begin(many).unwrap();
        assert!(transfers.begin(many).is_none(), "they have only just begun");
        age(&transfers);
        let third = transfers.begin(many).unwrap();
        assert!(slow.displaced.is_cancelled() && !fast.displaced.is_cancelled());
        assert_eq!(gauge.get(), 2);
        let other = transfers.begin(few).unwrap();
        age(&transfers);
        let another = transfers.begin(few).unwrap();
        assert!(third.displaced.is_cancelled() && !other.displaced.is_cancelled());
        assert_eq!(gauge.get(), 3);
        drop((fast, slow, third, other, another));
        assert_eq!(gauge.get(), 0);
    }
}
