//! Who calls: by API key, else by address.

use std::{
    collections::HashMap,
    hash::{DefaultHasher, Hash, Hasher},
    net::{IpAddr, SocketAddr},
};

use axum::{extract::Request, http::Extensions};

/// Address of the peer, an extension of every request from a connection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub(crate) SocketAddr);

impl Peer {
    /// The address as a caller.
    pub(crate) fn client(self) -> Client {
        Client::Address(match self.0.ip().to_canonical() {
            IpAddr::V6(address) => IpAddr::V6((address.to_bits() >> 64 << 64).into()),
            address => address,
        })
    }
}

/// A connection beyond those that there are places for, an extension of its requests: it may ask
/// how the server is, and nothing else.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spare;

/// One caller, as far as callers can be distinguished.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Client {
    /// Sent the API key of this index.
    Key(usize),
    /// Sent no key, from this address.
    Address(IpAddr),
    /// Ordered a job with a key that another replica knows: a hash of it.
    Stored(u64),
    /// Came without a connection, as in tests.
    Unknown,
}

/// Returns the client that is named most often; none of none.
pub(crate) fn most_frequent(clients: impl Iterator<Item = Client>) -> Option<Client> {
    let mut counts: HashMap<Client, usize> = HashMap::new();
    for client in clients {
        *counts.entry(client).or_default() += 1;
    }
    counts.into_iter().max_by_key(|&(_, count)| count).map(|(client, _)| client)
}

impl Client {
    /// The caller of a request, once it was identified.
    pub(crate) fn of(extensions: &Extensions) -> Self {
        extensions.get::<Self>().copied().unwrap_or(Self::Unknown)
    }

    /// Tells callers apart where nothing else of them matters.
    pub(crate) fn number(self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.hash(&mut hasher);
        hasher.finish()
    }

    /// Returns the peer's address; of IPv6 the network, as one host has all of it. A listener on
    /// `::` sees IPv4 peers as mapped addresses, all of one network.
    pub(crate) fn of_address(request: &Request) -> Self {
        let peer = request.extensions().get::<Peer>();
        peer.map_or(Self::Unknown, |peer| peer.client())
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
