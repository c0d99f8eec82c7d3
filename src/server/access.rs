//! Who may call the routes that work, and how often.

use std::{
    net::{IpAddr, SocketAddr},
    sync::atomic::{AtomicUsize, Ordering},
    time::Duration,
};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, header},
    middleware::Next,
    response::Response,
};
use governor::{Quota, RateLimiter, clock::Clock, state::keyed::HashMapStateStore};

use super::{
    body::IncomingBody,
    config::{ApiKey, Limits, Origin, Seconds},
    error::ServerError,
    state::SharedState,
};

/// Requests between two clean-ups of clients that have not been seen for a while.
const CLEAN_UP_AFTER: usize = 1_000;

/// Who is let in.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// Keys that callers must send one of; without any, everybody may call.
    pub keys: Vec<ApiKey>,
    /// Origins whose pages may call (CORS); `*` for all.
    pub origins: Vec<Origin>,
}

/// Address of the peer, which the connection puts beside every request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub(crate) SocketAddr);

/// One caller, as far as callers can be told apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Client {
    /// Sent the key of this number.
    Key(usize),
    /// Sent none, from this address.
    Address(IpAddr),
    /// Nothing is known; in tests.
    Unknown,
}

/// A token bucket for every client.
pub(crate) struct Rates {
    limiter: RateLimiter<Client, HashMapStateStore<Client>, governor::clock::DefaultClock>,
    per_minute: u32,
    checks: AtomicUsize,
}

impl Rates {
    /// None without a limit.
    pub(crate) fn new(limits: &Limits) -> Option<Self> {
        let per_minute = limits.rate_limit?;
        let every = Duration::from_secs(60) / per_minute.get();
        let quota = Quota::with_period(every.max(Duration::from_nanos(1)))?;
        Some(Self {
            limiter: RateLimiter::hashmap(quota.allow_burst(limits.rate_burst)),
            per_minute: per_minute.get(),
            checks: AtomicUsize::new(0),
        })
    }

    fn check(&self, client: Client) -> Result<(), ServerError> {
        if self.checks.fetch_add(1, Ordering::Relaxed) % CLEAN_UP_AFTER == CLEAN_UP_AFTER - 1 {
            self.limiter.retain_recent();
        }
        self.limiter.check_key(&client).map_err(|too_early| {
            let now = self.limiter.clock().now();
            ServerError::RateLimited {
                per_minute: self.per_minute,
                retry_after: Seconds(too_early.wait_time_from(now)),
            }
        })
    }
}

impl std::fmt::Debug for Rates {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Rates")
            .field("per_minute", &self.per_minute)
            .finish_non_exhaustive()
    }
}

/// Lets a request in that has a key, if keys are asked for, and is not one too many.
pub(crate) async fn admit(
    State(state): State<SharedState>,
    mut request: Request,
    next: Next,
) -> Result<Response, ServerError> {
    match let_in(&state, &request) {
        Ok(client) => {
            request.extensions_mut().insert(client);
            Ok(next.run(request).await)
        }
        Err(refused) => {
            // Read to its end, so that its sender gets to see why.
            drop(IncomingBody::new(request.into_body()));
            Err(refused)
        }
    }
}

/// Who knows no key has a bucket too: guessing is no faster than asking.
fn let_in(state: &SharedState, request: &Request) -> Result<Client, ServerError> {
    let client = identify(&state.access.keys, request);
    if let Some(rates) = &state.rates {
        rates.check(*client.as_ref().unwrap_or(&address(request)))?;
    }
    client
}

/// The peer's address; of IPv6 the network, as one host has all of it. A listener on `::` sees IPv4 peers as
/// mapped addresses, all of one network.
fn address(request: &Request) -> Client {
    let peer = request.extensions().get::<Peer>();
    match peer.map(|peer| peer.0.ip().to_canonical()) {
        None => Client::Unknown,
        Some(IpAddr::V6(address)) => {
            let network = address.to_bits() >> 64 << 64;
            Client::Address(IpAddr::V6(network.into()))
        }
        Some(address) => Client::Address(address),
    }
}

fn identify(keys: &[ApiKey], request: &Request) -> Result<Client, ServerError> {
    if keys.is_empty() {
        return Ok(address(request));
    }
    let sent = sent_key(request.headers()).ok_or(ServerError::KeyMissing)?;
    // All keys are looked at, so that the time tells nothing of which one it was.
    let mut known = None;
    for (number, key) in keys.iter().enumerate() {
        if key.is(sent) {
            known = Some(Client::Key(number));
        }
    }
    known.ok_or(ServerError::KeyWrong)
}

fn sent_key(headers: &HeaderMap) -> Option<&[u8]> {
    const SCHEME: &[u8] = b"bearer ";
    if let Some(key) = headers.get("x-api-key") {
        return Some(key.as_bytes());
    }
    let value = headers.get(header::AUTHORIZATION)?.as_bytes();
    let (scheme, key) = value.split_at_checked(SCHEME.len())?;
    scheme
        .eq_ignore_ascii_case(SCHEME)
        .then(|| key.trim_ascii())
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;

    use axum::body::Body;

    use super::*;

    fn request(name: &str, value: &str) -> Request {
        Request::builder()
            .header(name, value)
            .body(Body::empty())
            .unwrap()
    }

    #[test]
    fn a_key_is_found_in_either_header() {
        let keys = ["one", "two"].map(|key| key.parse().unwrap());
        let who = |name: &str, value: &str| identify(&keys, &request(name, value));
        assert_eq!(who("x-api-key", "two").unwrap(), Client::Key(1));
        assert_eq!(who("authorization", "bearer one").unwrap(), Client::Key(0));
        assert_eq!(who("authorization", "Bearer  one").unwrap(), Client::Key(0));
        assert!(matches!(who("x-api-key", "on"), Err(ServerError::KeyWrong)));
        for (name, value) in [("authorization", "Basic one"), ("cookie", "one")] {
            assert!(matches!(who(name, value), Err(ServerError::KeyMissing)));
        }
        assert_eq!(
            identify(&[], &request("x-api-key", "any")).unwrap(),
            Client::Unknown
        );
    }

    #[test]
    fn addresses_are_told_apart_as_hosts_have_them() {
        let from = |peer: &str| {
            let mut request = request("accept", "*/*");
            let peer = SocketAddr::new(peer.parse().unwrap(), 5000);
            request.extensions_mut().insert(Peer(peer));
            address(&request)
        };
        assert_ne!(from("192.0.2.1"), from("192.0.2.2"));
        assert_eq!(from("192.0.2.1"), from("::ffff:192.0.2.1"));
        assert_ne!(from("::ffff:192.0.2.1"), from("::ffff:192.0.2.2"));
        assert_eq!(from("2001:db8::1"), from("2001:db8::2:3"));
        assert_ne!(from("2001:db8::1"), from("2001:db8:0:1::1"));
    }

    #[test]
    fn every_client_has_a_bucket_of_its_own() {
        let limits = Limits {
            rate_limit: NonZeroU32::new(60),
            rate_burst: NonZeroU32::new(2).unwrap(),
            ..Limits::default()
        };
        let rates = Rates::new(&limits).unwrap();
        let first = Client::Key(0);
        assert!(rates.check(first).is_ok() && rates.check(first).is_ok());
        match rates.check(first) {
            Err(ServerError::RateLimited { retry_after, .. }) => {
                assert_eq!(retry_after.retry_after(), 1);
            }
            other => panic!("{other:?}"),
        }
        assert!(rates.check(Client::Key(1)).is_ok());
        assert!(Rates::new(&Limits::default()).is_none());
    }
}
