//! Places to work in, which clients take in turns: who works in the fewest is next.

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::oneshot;

use crate::server::layers::client::Client;

/// A bounded number of places, the last of them for short stays. A client works in at most its
/// share of the others, and waiting clients take turns, so that one that orders much makes nobody
/// wait but itself; and who stays long keeps no short stay waiting, not even of the same client.
#[derive(Debug)]
pub(crate) struct Turns(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    /// Places for all.
    places: usize,
    /// Places for short stays only.
    express: usize,
    share: usize,
    // Held only to count and to choose who is next.
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    taken: usize,
    express_taken: usize,
    /// Of the places for all.
    by_client: HashMap<Client, usize>,
    waiting: VecDeque<Waiting>,
}

#[derive(Debug)]
struct Waiting {
    client: Client,
    stay: Stay,
    sender: oneshot::Sender<Turn>,
}

/// How long somebody means to stay in a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stay {
    /// Any place will do: it leaves one for short stays soon.
    Short,
    /// In a place for all.
    Long,
}

/// A place to work in, given back on drop.
#[derive(Debug)]
pub(crate) struct Turn {
    of: Arc<Inner>,
    client: Client,
    /// Whether its place is for short stays only.
    pub(crate) is_express: bool,
}

impl Turns {
    /// `places` for all, of which one client takes `share` at most, and `express` ones.
    pub(crate) fn new(places: usize, share: usize, express: usize) -> Self {
        Self(Arc::new(Inner { places, express, share, state: Mutex::default() }))
    }

    /// A place, if there is one for this client now.
    pub(crate) fn try_take(&self, client: Client, stay: Stay) -> Option<Turn> {
        let mut state = self.0.state();
        let free = state.may(&self.0, client, stay);
        free.then(|| state.take(&self.0, client))
    }

    /// A place, with the time that it was waited for.
    pub(crate) async fn take(&self, client: Client, stay: Stay) -> (Turn, Duration) {
        let asked = Instant::now();
        let coming = {
            let mut state = self.0.state();
            if state.may(&self.0, client, stay) {
                return (state.take(&self.0, client), Duration::ZERO);
            }
            let (sender, coming) = oneshot::channel();
            state.waiting.push_back(Waiting { client, stay, sender });
            coming
        };
        match coming.await {
            Ok(turn) => (turn, asked.elapsed()),
            Err(_) => unreachable!("who waits is told, as long as there is somebody to tell it"),
        }
    }

    /// Whether this client would have to wait.
    pub(crate) fn is_full(&self, client: Client, stay: Stay) -> bool {
        !self.0.state().may(&self.0, client, stay)
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
                state.waiting.retain(|waiting| !waiting.sender.is_closed());
                let Some(Waiting { client, sender, .. }) = state.next(self) else {
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

    fn may(&self, inner: &Inner, client: Client, stay: Stay) -> bool {
        let express = stay == Stay::Short && self.express_taken < inner.express;
        self.may_share(inner, client) || express
    }

    /// Whether there is a place for all that this client may take.
    fn may_share(&self, inner: &Inner, client: Client) -> bool {
        let within = client == Client::Unknown || self.held(client) < inner.share;
        self.taken < inner.places && within
    }

    /// A place for all where there is one, else an express one.
    fn take(&mut self, inner: &Arc<Inner>, client: Client) -> Turn {
        let is_express = !self.may_share(inner, client);
        if is_express {
            self.express_taken += 1;
        } else {
            self.taken += 1;
            *self.by_client.entry(client).or_default() += 1;
        }
        Turn { of: Arc::clone(inner), client, is_express }
    }

    /// Who waits first of those whose clients have the fewest places.
    fn next(&mut self, inner: &Inner) -> Option<Waiting> {
        let waiting = self.waiting.iter().enumerate();
        let may = waiting.filter(|(_, waits)| self.may(inner, waits.client, waits.stay));
        let place = may.min_by_key(|(_, waits)| self.held(waits.client))?.0;
        self.waiting.remove(place)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let mut state = self.of.state();
        if self.is_express {
            state.express_taken -= 1;
        } else {
            state.taken -= 1;
            if let Some(held) = state.by_client.get_mut(&self.client) {
                *held -= 1;
                if *held == 0 {
                    state.by_client.remove(&self.client);
                }
            }
        }
        drop(state);
        self.of.go_on();
    }
}

#[cfg(test)]
mod tests {
    use super::{Stay::*, *};

    const A: Client = Client::Key(0);
    const B: Client = Client::Key(1);

    /// Waits in the order of the calls.
    async fn wait(turns: &Arc<Turns>, client: Client, stay: Stay) -> tokio::task::JoinHandle<Turn> {
        let before = turns.0.state().waiting.len();
        let waits = Arc::clone(turns);
        let handle = tokio::spawn(async move { waits.take(client, stay).await.0 });
        while turns.0.state().waiting.len() == before {
            tokio::task::yield_now().await;
        }
        handle
    }

    #[tokio::test]
    async fn who_has_the_fewest_places_is_next() {
        let turns = Arc::new(Turns::new(2, 2, 0));
        let [first, second] = [(); 2].map(|()| turns.try_take(A, Short).unwrap());
        assert!(turns.is_full(B, Short) && turns.try_take(B, Short).is_none());
        let (third, of_b) = (wait(&turns, A, Short).await, wait(&turns, B, Short).await);
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
        let turns = Arc::new(Turns::new(2, 1, 0));
        let first = turns.try_take(A, Long).unwrap();
        assert!(turns.is_full(A, Long) && !turns.is_full(B, Long));
        let leaves = wait(&turns, A, Long).await;
        let waits = wait(&turns, A, Long).await;
        leaves.abort();
        assert!(leaves.await.is_err());
        drop(first);
        drop(waits.await.unwrap());
        assert_eq!(turns.0.state().taken, 0);
    }

    #[tokio::test]
    async fn long_stays_leave_a_place_for_short_ones_of_whomever() {
        let turns = Arc::new(Turns::new(2, 1, 1));
        let [long, other] = [A, B].map(|client| turns.try_take(client, Long).unwrap());
        assert!(turns.is_full(A, Long) && !turns.is_full(A, Short));
        let short = turns.try_take(A, Short).unwrap();
        assert!(short.is_express && !long.is_express);
        let (waits_long, waits_short) = (wait(&turns, B, Long).await, wait(&turns, A, Short).await);
        drop(short);
        let short = waits_short.await.unwrap();
        assert!(short.is_express && !waits_long.is_finished());
        // Its own share is free first.
        drop(long);
        assert!(!turns.try_take(A, Short).unwrap().is_express);
        drop((other, short));
        assert!(!waits_long.await.unwrap().is_express);
        let state = turns.0.state();
        assert_eq!((state.taken, state.express_taken), (0, 0));
    }
}
