//! How often a client may call.

use std::{
    sync::atomic::{AtomicUsize, Ordering},
    time::Duration,
};

use governor::{Quota, RateLimiter, clock::Clock, state::keyed::HashMapStateStore};

use super::client::Client;
use crate::server::{
    config::{Limits, Seconds},
    error::ServerError,
};

/// Requests between two clean-ups of clients that have not been seen for a while.
const CLEAN_UP_AFTER: usize = 1_000;

/// A token bucket for every client.
pub(super) struct Rates {
    limiter: RateLimiter<Client, HashMapStateStore<Client>, governor::clock::DefaultClock>,
    per_minute: u32,
    checks: AtomicUsize,
}

impl Rates {
    /// Returns none without a limit.
    pub(super) fn new(limits: &Limits) -> Option<Self> {
        let per_minute = limits.rate_limit?;
        let every = Duration::from_secs(60) / per_minute.get();
        let quota = Quota::with_period(every.max(Duration::from_nanos(1)))?;
        Some(Self {
            limiter: RateLimiter::hashmap(quota.allow_burst(limits.rate_burst)),
            per_minute: per_minute.get(),
            checks: AtomicUsize::new(0),
        })
    }

    pub(super) fn check(&self, client: Client) -> Result<(), ServerError> {
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
        f.debug_struct("Rates").field("per_minute", &self.per_minute).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;

    use super::*;

    #[test]
    fn every_client_has_its_own_bucket() {
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
