//! Places to work in, which clients take in turns: who works in the fewest is next.

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::oneshot;

use crate::server::layers::client::Client;

/// A bounded number of places. A client works in at most its share of them, and waiting clients
/// take turns, so that one that orders much makes nobody wait but itself.
#[derive(Debug)]
pub(crate) struct Turns(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    places: usize,
    share: usize,
    // Held only to count and to choose who is next.
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    taken: usize,
    by_client: HashMap<Client, usize>,
    waiting: VecDeque<(Client, oneshot::Sender<Turn>)>,
}

/// A place to work in, given back on drop.
#[derive(Debug)]
pub(crate) struct Turn {
    of: Arc<Inner>,
    client: Client,
}

impl Turns {
    /// `places`, of which one client takes `share` at most.
    pub(crate) fn new(places: usize, share: usize) -> Self {
        Self(Arc::new(Inner { places, share, state: Mutex::default() }))
    }

    /// A place, if there is one for this client now.
    pub(crate) fn try_take(&self, client: Client) -> Option<Turn> {
        let mut state = self.0.state();
        let free = state.may(&self.0, client);
        free.then(|| state.take(&self.0, client))
    }

    /// A place, with the time that it was waited for.
    pub(crate) async fn take(&self, client: Client) -> (Turn, Duration) {
        let asked = Instant::now();
        let coming = {
            let mut state = self.0.state();
            if state.may(&self.0, client) {
                return (state.take(&self.0, client), Duration::ZERO);
            }
            let (sender, coming) = oneshot::channel();
            state.waiting.push_back((client, sender));
            coming
        };
        match coming.await {
            Ok(turn) => (turn, asked.elapsed()),
            Err(_) => unreachable!("who waits is told, as long as there is somebody to tell it"),
        }
    }

    /// Whether this client would have to wait.
    pub(crate) fn is_full(&self, client: Client) -> bool {
        !self.0.state().may(&self.0, client)
    }
}

impl Inner {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives free places to those who are next.
    fn go_on(self: &Arc<Self>) {
        loop {
            let (sender, turn) = {
                let mut state = self.state();
                state.waiting.retain(|(_, sender)| !sender.is_closed());
                let Some((client, sender)) = state.next(self) else {
                    return;
                };
                (sender, state.take(self, client))
            };
            // Who left meanwhile gives its place back, which goes to the next then.
            drop(sender.send(turn));
        }
    }
}

impl State {
    fn held(&self, client: Client) -> usize {
        self.by_client.get(&client).copied().unwrap_or(0)
    }

    fn may(&self, inner: &Inner, client: Client) -> bool {
        let within = client == Client::Unknown || self.held(client) < inner.share;
        self.taken < inner.places && within
    }

    fn take(&mut self, inner: &Arc<Inner>, client: Client) -> Turn {
        self.taken += 1;
        *self.by_client.entry(client).or_default() += 1;
        Turn { of: Arc::clone(inner), client }
    }

    /// Who waits first of those whose clients have the fewest places.
    fn next(&mut self, inner: &Inner) -> Option<(Client, oneshot::Sender<Turn>)> {
        let waiting = self.waiting.iter().enumerate();
        let may = waiting.filter(|(_, (client, _))| self.may(inner, *client));
        let place = may.min_by_key(|(_, (client, _))| self.held(*client))?.0;
        self.waiting.remove(place)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let mut state = self.of.state();
        state.taken -= 1;
        if let Some(held) = state.by_client.get_mut(&self.client) {
            *held -= 1;
            if *held == 0 {
                state.by_client.remove(&self.client);
            }
        }
        drop(state);
        self.of.go_on();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Client = Client::Key(0);
    const B: Client = Client::Key(1);

    /// Waits in the order of the calls.
    async fn wait(turns: &Arc<Turns>, client: Client) -> tokio::task::JoinHandle<Turn> {
        let before = turns.0.state().waiting.len();
        let waits = Arc::clone(turns);
        let handle = tokio::spawn(async move { waits.take(client).await.0 });
        while turns.0.state().waiting.len() == before {
            tokio::task::yield_now().await;
        }
        handle
    }

    #[tokio::test]
    async fn who_has_the_fewest_places_is_next() {
        let turns = Arc::new(Turns::new(2, 2));
        let (first, second) = (turns.try_take(A).unwrap(), turns.try_take(A).unwrap());
        assert!(turns.is_full(B) && turns.try_take(B).is_none());
        let (third, of_b) = (wait(&turns, A).await, wait(&turns, B).await);
        drop(first);
        let of_b = of_b.await.unwrap();
        assert!(!third.is_finished());
        drop(second);
        drop(third.await.unwrap());
        drop(of_b);
        assert!(turns.0.state().by_client.is_empty());
    }

    #[tokio::test]
    async fn a_client_leaves_places_to_others_and_who_leaves_the_line_holds_none() {
        let turns = Arc::new(Turns::new(2, 1));
        let first = turns.try_take(A).unwrap();
        assert!(turns.is_full(A) && !turns.is_full(B));
        let leaves = wait(&turns, A).await;
        let waits = wait(&turns, A).await;
        leaves.abort();
        assert!(leaves.await.is_err());
        drop(first);
        drop(waits.await.unwrap());
        assert_eq!(turns.0.state().taken, 0);
    }
}
