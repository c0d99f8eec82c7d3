//! Who calls: by API key, else by address.

use std::net::{IpAddr, SocketAddr};

use axum::extract::Request;

/// Address of the peer, an extension of every request from a connection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub(crate) SocketAddr);

/// One caller, as far as callers can be distinguished.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Client {
    /// Sent the API key of this index.
    Key(usize),
    /// Sent no key, from this address.
    Address(IpAddr),
    /// Came without a connection, as in tests.
    Unknown,
}

impl Client {
    /// Returns the peer's address; of IPv6 the network, as one host has all of it. A listener on
    /// `::` sees IPv4 peers as mapped addresses, all of one network.
    pub(crate) fn of_address(request: &Request) -> Self {
        let peer = request.extensions().get::<Peer>();
        match peer.map(|peer| peer.0.ip().to_canonical()) {
            None => Self::Unknown,
            Some(IpAddr::V6(address)) => {
                let network = address.to_bits() >> 64 << 64;
                Self::Address(IpAddr::V6(network.into()))
            }
            Some(address) => Self::Address(address),
        }
    }
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    #[test]
    fn addresses_are_distinguished_as_hosts_have_them() {
        let from = |peer: &str| {
            let mut request = Request::new(Body::empty());
            let peer = SocketAddr::new(peer.parse().unwrap(), 5000);
            request.extensions_mut().insert(Peer(peer));
            Client::of_address(&request)
        };
        assert_ne!(from("192.0.2.1"), from("192.0.2.2"));
        assert_eq!(from("192.0.2.1"), from("::ffff:192.0.2.1"));
        assert_ne!(from("::ffff:192.0.2.1"), from("::ffff:192.0.2.2"));
        assert_eq!(from("2001:db8::1"), from("2001:db8::2:3"));
        assert_ne!(from("2001:db8::1"), from("2001:db8:0:1::1"));
    }
}
