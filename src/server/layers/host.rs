//! The host that a request is for: one, and one of those that are allowed. A page that reaches this
//! server under a name of its own (DNS rebinding) is refused so.

use axum::http::{Request, Version, header};

use super::client::Peer;
use crate::server::{error::ServerError, options::shorten};

/// Checks the host of a request that came through a connection.
///
/// # Errors
/// [`ServerError::Host`] for none or several over HTTP/1.1; [`ServerError::OtherHost`] where only
/// others are `allowed`.
pub(super) fn check<B>(request: &Request<B>, allowed: &[String]) -> Result<(), ServerError> {
    if request.extensions().get::<Peer>().is_none() {
        return Ok(());
    }
    let hosts: Vec<_> = request.headers().get_all(header::HOST).iter().collect();
    let one = hosts.len() == 1 || hosts.is_empty() && request.version() != Version::HTTP_11;
    if !one {
        return Err(ServerError::Host);
    }
    if allowed.is_empty() {
        return Ok(());
    }
    let authority = request.uri().authority().map(|authority| authority.as_str());
    let named = hosts.first().and_then(|host| host.to_str().ok()).or(authority);
    let host = without_port(named.unwrap_or_default());
    match allowed.iter().any(|allowed| allowed.eq_ignore_ascii_case(host)) {
        true => Ok(()),
        false => Err(ServerError::OtherHost { host: shorten(host) }),
    }
}

fn without_port(authority: &str) -> &str {
    match authority.rsplit_once(':') {
        // What is left of an IPv6 address ends with its bracket.
        Some((host, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => host,
        _ => authority,
    }
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn request(version: Version, hosts: &[&'static str]) -> Request<()> {
        let mut request = Request::new(());
        *request.version_mut() = version;
        let peer = Peer(([127, 0, 0, 1], 5000).into());
        request.extensions_mut().insert(peer);
        for host in hosts {
            request.headers_mut().append(header::HOST, HeaderValue::from_static(host));
        }
        request
    }

    #[test]
    fn a_request_names_one_host() {
        let any = |version, hosts: &[&'static str]| check(&request(version, hosts), &[]).is_ok();
        assert!(any(Version::HTTP_11, &["x"]) && any(Version::HTTP_10, &[]));
        assert!(any(Version::HTTP_2, &[]));
        assert!(!any(Version::HTTP_11, &[]) && !any(Version::HTTP_11, &["x", "x"]));
    }

    #[test]
    fn only_allowed_hosts_are_answered_for() {
        let allowed = ["dance.example".to_owned(), "[::1]".to_owned()];
        let of = |host| check(&request(Version::HTTP_11, &[host]), &allowed).is_ok();
        assert!(of("dance.example") && of("Dance.Example:8080") && of("[::1]:8080"));
        assert!(!of("evil.example") && !of("dance.example.evil.example") && !of(""));
    }
}
