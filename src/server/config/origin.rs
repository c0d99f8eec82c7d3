//! Origins whose pages may call (CORS).

use std::str::FromStr;

use axum::http::{
    HeaderValue,
    uri::{Authority, Scheme},
};

/// An origin whose pages may call, as browsers name it, or `*` for all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin(HeaderValue);

impl Origin {
    /// Returns whether this is `*`.
    pub(crate) fn is_any(&self) -> bool {
        self.0 == "*"
    }

    /// Returns the value of the header `Origin` from its pages.
    pub(crate) fn header(&self) -> HeaderValue {
        self.0.clone()
    }
}

impl FromStr for Origin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim().to_ascii_lowercase();
        // Pages from files and in sandboxes are of the origin `null` (WHATWG HTML, section 7.1.1).
        let possible = text == "*" || text == "null" || is_origin(&text);
        possible.then(|| HeaderValue::try_from(text).ok()).flatten().map(Self).ok_or_else(|| {
            "give *, null, or scheme://host[:port] without a path, such as https://dance.example"
                .to_owned()
        })
    }
}

/// Returns whether `text` is a scheme, a host and perhaps a port (RFC 6454, section 6.1).
fn is_origin(text: &str) -> bool {
    let Some((scheme, place)) = text.split_once("://") else {
        return false;
    };
    let Ok(authority) = place.parse::<Authority>() else {
        return false;
    };
    let after_host = place.strip_prefix(authority.host());
    let port_fits =
        after_host.is_some_and(|rest| rest.is_empty() || authority.port_u16().is_some());
    let scheme_fits = !scheme.is_empty() && scheme.parse::<Scheme>().is_ok();
    scheme_fits && !authority.host().is_empty() && port_fits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_a_browser_can_say_is_an_origin() {
        for (text, header) in [
            ("*", "*"),
            ("https://dance.example", "https://dance.example"),
            (" HTTPS://Dance.Example ", "https://dance.example"),
            ("http://localhost:3000", "http://localhost:3000"),
            ("http://[::1]:3000", "http://[::1]:3000"),
            ("chrome-extension://abcdef", "chrome-extension://abcdef"),
            ("null", "null"),
        ] {
            let origin: Origin = text.parse().unwrap();
            assert_eq!(origin.header(), header);
            assert_eq!(origin.is_any(), text == "*");
        }
        for text in [
            "",
            "dance.example",
            "https://",
            "https://dance.example/",
            "https://dance.example/page",
            "https://dance.example?x",
            "https://me@dance.example",
            "https://dance.example:",
            "https://dance.example:99999",
            "https://dance .example",
            "https://*.example:x",
            "://dance.example",
            "**",
        ] {
            assert!(text.parse::<Origin>().is_err(), "{text:?}");
        }
    }
}
