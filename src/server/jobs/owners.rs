//! Clients as the table of jobs names them: the same on every replica and after a restart.

use crate::server::{config::ApiKey, layers::client::Client};

/// Names of clients: of a key a part of its hash, for the table must not show it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Owners {
    keys: Vec<String>,
}

const KEY: &str = "key-";
const ADDRESS: &str = "address-";
const UNKNOWN: &str = "unknown";

impl Owners {
    pub(crate) fn new(keys: &[ApiKey]) -> Self {
        let name = |key: &ApiKey| format!("{KEY}{}", key.fingerprint());
        Self { keys: keys.iter().map(name).collect() }
    }

    pub(crate) fn name(&self, client: Client) -> String {
        match client {
            Client::Key(number) => {
                self.keys.get(number).cloned().unwrap_or_else(|| UNKNOWN.to_owned())
            }
            Client::Address(address) => format!("{ADDRESS}{address}"),
            Client::Unknown => UNKNOWN.to_owned(),
            Client::Stored(number) => format!("{KEY}{number:016x}"),
        }
    }

    /// The client of a name, which may be one that this replica has no key of.
    pub(crate) fn client(&self, name: &str) -> Client {
        if let Some(number) = self.keys.iter().position(|key| key == name) {
            return Client::Key(number);
        }
        if let Some(address) = name.strip_prefix(ADDRESS).and_then(|text| text.parse().ok()) {
            return Client::Address(address);
        }
        let stored = name.strip_prefix(KEY).and_then(|text| u64::from_str_radix(text, 16).ok());
        stored.map_or(Client::Unknown, Client::Stored)
    }

    /// Whether a job of this owner is found by all who know its id.
    pub(crate) fn is_open(owner: &str) -> bool {
        !owner.starts_with(KEY)
    }

    /// Whether an owner cannot be distinguished from others, and so has no share of its own.
    pub(crate) fn is_unknown(owner: &str) -> bool {
        owner == UNKNOWN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_leads_back_to_its_client() {
        let owners = Owners::new(&["one", "two"].map(|key| key.parse().unwrap()));
        let address = Client::Address("2001:db8::".parse().unwrap());
        for client in [Client::Key(0), Client::Key(1), address, Client::Unknown] {
            assert_eq!(owners.client(&owners.name(client)), client);
        }
        let name = owners.name(Client::Key(1));
        assert!(!name.contains("two"));
        let elsewhere = Owners::default();
        let stored = elsewhere.client(&name);
        assert!(matches!(stored, Client::Stored(_)));
        assert_eq!(elsewhere.name(stored), name);
    }
}
