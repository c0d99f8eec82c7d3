//! Who may be told that a job has ended, and how it is told: signed as Standard Webhooks
//! (<https://www.standardwebhooks.com>) says, to hosts of an allow-list, and to no private address.

use std::{
    convert::Infallible,
    fmt,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    ops::RangeInclusive,
    str::FromStr,
    time::Duration,
};

use base64::{Engine, engine::general_purpose::STANDARD};
use hmac::{Hmac, KeyInit, Mac};
use reqwest::{
    Client, Url,
    dns::{Addrs, Name, Resolve, Resolving},
    redirect::Policy,
};
use sha2::Sha256;

/// Longest time for one call.
const CALL: Duration = Duration::from_secs(10);

/// Bytes of a key, as Standard Webhooks has them.
const KEY: RangeInclusive<usize> = 24..=64;

/// What callbacks are signed with. Its text is never shown: a secret that cannot be used is read,
/// so that no parser repeats it, and refused by [`Self::check`].
#[derive(Clone, PartialEq, Eq)]
pub struct CallbackSecret(Result<Vec<u8>, SecretError>);

/// Why callbacks cannot be signed with a secret.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SecretError {
    /// There is none.
    #[error("is empty")]
    Empty,
    /// It was written some other way.
    #[error("is no base64, with or without `whsec_` before it")]
    Base64,
    /// It can be guessed, or is longer than receivers expect.
    #[error("holds {0} bytes of key, expected 24 to 64")]
    Length(usize),
}

impl CallbackSecret {
    /// Whether callbacks can be signed with it.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self) -> Result<(), SecretError> {
        self.0.as_ref().map(|_| ()).map_err(|error| *error)
    }
}

impl Default for CallbackSecret {
    fn default() -> Self {
        Self(Err(SecretError::Empty))
    }
}

impl FromStr for CallbackSecret {
    type Err = Infallible;

    /// Reads `whsec_` and base64, or base64 alone, as the libraries of Standard Webhooks do.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        let text = text.trim();
        let text = text.strip_prefix("whsec_").unwrap_or(text);
        Ok(Self(match STANDARD.decode(text) {
            Ok(key) if key.is_empty() => Err(SecretError::Empty),
            Ok(key) if KEY.contains(&key.len()) => Ok(key),
            Ok(key) => Err(SecretError::Length(key.len())),
            Err(_) => Err(SecretError::Base64),
        }))
    }
}

impl fmt::Debug for CallbackSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("CallbackSecret(..)")
    }
}

/// Who may be called, and what calls are signed with.
#[derive(Clone, Debug, Default)]
pub struct CallbackPolicy {
    /// Hosts; `*.name` for those below a name, `*` for all.
    pub allow: Vec<String>,
    /// The secret of the signature.
    pub secret: CallbackSecret,
    /// Whether `http` and private addresses are allowed.
    pub private: bool,
}

impl CallbackPolicy {
    /// Checks a URL that a job names.
    ///
    /// # Errors
    /// What is wrong with it, and what is accepted.
    pub(crate) fn check(&self, url: &str) -> Result<(), String> {
        if self.allow.is_empty() {
            return Err(
                "this server calls nobody: its setting --callback-allow is empty".to_owned()
            );
        }
        let url: Url = url.parse().map_err(|error| format!("it is no URL: {error}"))?;
        let schemes: &[&str] = if self.private { &["https", "http"] } else { &["https"] };
        if !schemes.contains(&url.scheme()) {
            return Err(format!("expected a URL with {}", schemes.join(" or ")));
        }
        let host = url.host_str().unwrap_or_default().to_ascii_lowercase();
        if !url.username().is_empty() || url.password().is_some() {
            return Err("a URL with a password is not accepted: calls are signed".to_owned());
        }
        if !self.allow.iter().any(|pattern| admits(&pattern.to_ascii_lowercase(), &host)) {
            return Err(format!("this server does not call {host}"));
        }
        let address = host.trim_matches(['[', ']']).parse::<IpAddr>();
        match address {
            Ok(address) if !self.private && !is_public(address) => {
                Err(format!("this server does not call private addresses such as {address}"))
            }
            _ => Ok(()),
        }
    }

    /// A client that calls nobody else, whatever a name resolves to.
    pub(crate) fn client(&self) -> reqwest::Result<Client> {
        // One that was chosen before stays.
        drop(rustls::crypto::ring::default_provider().install_default());
        Client::builder()
            .timeout(CALL)
            .redirect(Policy::none())
            .no_proxy()
            .dns_resolver(PublicOnly { private: self.private })
            .user_agent(concat!("bailando/", env!("CARGO_PKG_VERSION")))
            .build()
    }

    /// The value of `webhook-signature` for a message.
    pub(crate) fn sign(&self, id: &str, timestamp: i64, body: &str) -> String {
        // A server whose secret is none does not start; a key of any length is one of HMAC
        // (RFC 2104).
        let key = self.secret.0.as_deref().unwrap_or_default();
        let Ok(mut mac) = Hmac::<Sha256>::new_from_slice(key) else { return String::new() };
        mac.update(format!("{id}.{timestamp}.{body}").as_bytes());
        format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()))
    }
}

fn admits(pattern: &str, host: &str) -> bool {
    match pattern.strip_prefix("*.") {
        _ if pattern == "*" => true,
        Some(name) => host.strip_suffix(name).is_some_and(|below| below.ends_with('.')),
        None => pattern == host,
    }
}

/// Resolves names to public addresses only: one that anybody can register may point inside.
struct PublicOnly {
    private: bool,
}

impl Resolve for PublicOnly {
    fn resolve(&self, name: Name) -> Resolving {
        let private = self.private;
        Box::pin(async move {
            let found = tokio::net::lookup_host((name.as_str(), 0)).await?;
            let allowed: Vec<SocketAddr> =
                found.filter(|address| private || is_public(address.ip())).collect();
            if allowed.is_empty() {
                let refused = format!("{} has no public address", name.as_str());
                return Err(refused.into());
            }
            let addresses: Addrs = Box::new(allowed.into_iter());
            Ok::<_, Box<dyn std::error::Error + Send + Sync>>(addresses)
        })
    }
}

/// Whether an address is on the open Internet (IANA's registries of special addresses).
fn is_public(address: IpAddr) -> bool {
    match address.to_canonical() {
        IpAddr::V4(address) => is_public_v4(address),
        IpAddr::V6(address) => is_public_v6(address),
    }
}

fn is_public_v4(address: Ipv4Addr) -> bool {
    let [a, b, c, _] = address.octets();
    let special = address.is_private()
        || address.is_loopback()
        || address.is_link_local()
        || address.is_documentation()
        || address.is_multicast()
        || a == 0
        || a >= 240
        || (a == 100 && (64..128).contains(&b))
        || (a == 198 && (18..20).contains(&b))
        || (a == 192 && b == 0 && c == 0);
    !special
}

fn is_public_v6(address: Ipv6Addr) -> bool {
    let [a, b, ..] = address.segments();
    // Global unicast, without documentation, Teredo and 6to4, which may lead inside.
    (0x2000..0x4000).contains(&a)
        && a != 0x2002
        && !(a == 0x2001 && (b < 0x200 || b == 0xdb8))
        && a != 0x3fff
}

#[cfg(test)]
mod tests {
    use super::*;

    fn policy(allow: &[&str], private: bool) -> CallbackPolicy {
        let allow = allow.iter().map(|host| (*host).to_owned()).collect();
        CallbackPolicy { allow, private, ..CallbackPolicy::default() }
    }

    #[test]
    fn only_hosts_of_the_list_are_called() {
        let some = policy(&["a.example", "*.b.example"], false);
        for url in ["https://a.example/x?y", "https://A.example", "https://c.b.example:8443/"] {
            assert_eq!(some.check(url), Ok(()), "{url}");
        }
        for url in [
            "http://a.example",
            "https://b.example",
            "https://ab.example",
            "https://evilb.example",
            "https://a.example.evil",
            "https://me:secret@a.example",
            "ftp://a.example",
            "a.example",
            "",
        ] {
            assert!(some.check(url).is_err(), "{url}");
        }
        assert!(policy(&[], false).check("https://a.example").is_err());
    }

    #[test]
    fn private_addresses_are_called_only_where_that_is_allowed() {
        let any = policy(&["*"], false);
        for host in [
            "127.0.0.1",
            "10.1.2.3",
            "192.168.1.1",
            "172.16.0.1",
            "169.254.169.254",
            "100.64.0.1",
            "0.0.0.0",
            "[::1]",
            "[fd00::1]",
            "[fe80::1]",
            "[::ffff:10.0.0.1]",
            "[2002:7f00:1::]",
            "2130706433",
            "0x7f.1",
            "198.18.0.1",
            "224.0.0.1",
        ] {
            assert!(any.check(&format!("https://{host}/")).is_err(), "{host}");
        }
        for host in ["8.8.8.8", "[2606:4700::1111]"] {
            assert_eq!(any.check(&format!("https://{host}/")), Ok(()), "{host}");
        }
        assert_eq!(policy(&["*"], true).check("http://127.0.0.1:9/x"), Ok(()));
    }

    #[tokio::test]
    async fn a_name_that_resolves_to_a_private_address_is_not_called() {
        let called = policy(&["*"], false).client().unwrap().get("https://localhost:1/").send();
        let failed = format!("{:?}", called.await.unwrap_err());
        assert!(failed.contains("no public address"), "{failed}");
    }

    /// The example of the specification's reference libraries.
    #[test]
    fn calls_are_signed_as_standard_webhooks_says() {
        let secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".parse().unwrap();
        let policy = CallbackPolicy { secret, ..CallbackPolicy::default() };
        let signature =
            policy.sign("msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, "{\"test\": 2432232314}");
        assert_eq!(signature, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
        assert_eq!(format!("{:?}", policy.secret), "CallbackSecret(..)");
    }

    #[test]
    fn a_secret_is_base64_of_a_key_that_nobody_guesses() {
        let key = STANDARD.encode([7; 32]);
        let read = |text: &str| text.parse::<CallbackSecret>().unwrap();
        assert_eq!(read(&format!("whsec_{key}")).0, Ok(vec![7; 32]));
        assert_eq!(read(&format!(" {key}\n")), read(&format!("whsec_{key}")));
        for (text, wrong) in [
            ("", SecretError::Empty),
            (" ", SecretError::Empty),
            ("whsec_", SecretError::Empty),
            ("a secret", SecretError::Base64),
            ("whsec_a-secret_of_32-characters..", SecretError::Base64),
            ("c2VjcmV0", SecretError::Length(6)),
            (&STANDARD.encode([7; 23]), SecretError::Length(23)),
            (&STANDARD.encode([7; 65]), SecretError::Length(65)),
        ] {
            assert_eq!(read(text).check(), Err(wrong), "{text:?}");
        }
    }
}
