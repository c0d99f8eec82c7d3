//! API keys and rate limits.

use std::sync::Arc;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, header},
    middleware::Next,
    response::Response,
};

use super::{client::Client, rate_limit::Rates};
use crate::server::{
    config::{Access, ApiKey, Limits},
    error::ServerError,
    upload::body::IncomingBody,
};

/// The API keys and rate limits that requests are checked against.
#[derive(Debug)]
pub(crate) struct Gate {
    keys: Vec<ApiKey>,
    rates: Option<Rates>,
}

impl Gate {
    pub(crate) fn new(access: &Access, limits: &Limits) -> Self {
        Self { keys: access.keys.clone(), rates: Rates::new(limits) }
    }

    /// Requests without a known key have a bucket too: guessing keys is no faster than calling.
    fn check(&self, request: &Request) -> Result<Client, ServerError> {
        let client = identify(&self.keys, request);
        if let Some(rates) = &self.rates {
            let by_address = || Client::of_address(request);
            rates.check(client.as_ref().copied().unwrap_or_else(|_| by_address()))?;
        }
        client
    }
}

/// Passes requests on that have a key, if keys are required, and keep to the rate limit.
pub(crate) async fn admit(
    State(gate): State<Arc<Gate>>,
    mut request: Request,
    next: Next,
) -> Result<Response, ServerError> {
    match gate.check(&request) {
        Ok(client) => {
            request.extensions_mut().insert(client);
            Ok(next.run(request).await)
        }
        Err(refused) => {
            // Reads the rest of the body, so that the client sees the answer.
            drop(IncomingBody::new(request.into_body()));
            Err(refused)
        }
    }
}

fn identify(keys: &[ApiKey], request: &Request) -> Result<Client, ServerError> {
    if keys.is_empty() {
        return Ok(Client::of_address(request));
    }
    let sent = sent_key(request.headers()).ok_or(ServerError::KeyMissing)?;
    // Compares all keys, so that the time does not depend on which one matches.
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
    scheme.eq_ignore_ascii_case(SCHEME).then(|| key.trim_ascii())
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn request(name: &str, value: &str) -> Request {
        Request::builder().header(name, value).body(Body::empty()).unwrap()
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
        assert_eq!(identify(&[], &request("x-api-key", "any")).unwrap(), Client::Unknown);
    }
}
