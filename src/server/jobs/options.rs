//! What a job has beside the options of its dance: priority, expiry, and where its end is told.

use axum::http::{HeaderMap, Uri};

use crate::server::{callbacks::CallbackPolicy, error::ServerError, options::shorten};

/// Largest priority, in both directions.
pub(crate) const MOST_PRIORITY: i64 = 100;
/// Longest time in seconds that a job may wait for a worker, where its order says so: a year.
pub(crate) const LONGEST_WAIT: f64 = 31_536_000.0;
const LONGEST_KEY: usize = 255;
/// Longest `callback_url` in bytes.
const LONGEST_URL: usize = 1024;

/// Options of a job that say nothing about its dance.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct JobOptions {
    pub(crate) priority: Option<i64>,
    /// Seconds after which it is no longer wanted, if it has not begun.
    pub(crate) expires_s: Option<f64>,
    pub(crate) callback_url: Option<String>,
    /// From the header `Idempotency-Key`.
    pub(crate) idempotency_key: Option<String>,
}

impl JobOptions {
    /// Takes those of a query, and returns it without them.
    ///
    /// # Errors
    /// [`ServerError::Option`].
    pub(crate) fn take_query(&mut self, uri: &Uri) -> Result<Uri, ServerError> {
        let mut rest = Vec::new();
        for pair in uri.query().unwrap_or_default().split('&').filter(|pair| !pair.is_empty()) {
            let name = pair.split('=').next().unwrap_or_default();
            if !NAMES.contains(&name) {
                rest.push(pair);
                continue;
            }
            let alone = Uri::builder().path_and_query(format!("/?{pair}")).build();
            let alone = alone.ok().and_then(|alone| {
                let query = axum::extract::Query::<Vec<(String, String)>>::try_from_uri(&alone);
                query.ok()?.0.pop()
            });
            let value = alone.map_or_else(String::new, |(_, value)| value);
            self.take(name, &value)?;
        }
        let path = format!("{}?{}", uri.path(), rest.join("&"));
        Ok(path.parse().unwrap_or_default())
    }

    /// Takes an option, if it is one of a job.
    ///
    /// # Errors
    /// [`ServerError::Option`].
    pub(crate) fn take(&mut self, name: &str, text: &str) -> Result<bool, ServerError> {
        let refuse = |accepted: String| {
            let problem = format!("got {:?}, expected {accepted}", shorten(text));
            Err(ServerError::Option { name: name.to_owned(), problem })
        };
        let known = match name {
            "priority" => {
                let fits = |value: &i64| (-MOST_PRIORITY..=MOST_PRIORITY).contains(value);
                let Some(value) = text.parse().ok().filter(fits) else {
                    return refuse(format!(
                        "a whole number from -{MOST_PRIORITY} to {MOST_PRIORITY}"
                    ));
                };
                self.priority.replace(value).is_some()
            }
            "expires_s" => {
                let fits = |value: &f64| *value > 0.0 && *value <= LONGEST_WAIT;
                let Some(value) = text.parse().ok().filter(fits) else {
                    return refuse(format!("a number above 0, up to {LONGEST_WAIT}"));
                };
                self.expires_s.replace(value).is_some()
            }
            "callback_url" if text.len() <= LONGEST_URL => {
                self.callback_url.replace(text.to_owned()).is_some()
            }
            "callback_url" => return refuse(format!("a URL of up to {LONGEST_URL} bytes")),
            _ => return Ok(false),
        };
        match known {
            true => Err(ServerError::Option {
                name: name.to_owned(),
                problem: "it was given more than once".to_owned(),
            }),
            false => Ok(true),
        }
    }

    /// Takes the header `Idempotency-Key`.
    ///
    /// # Errors
    /// [`ServerError::Option`] for one that is empty, too long or not of visible ASCII.
    pub(crate) fn take_headers(&mut self, headers: &HeaderMap) -> Result<(), ServerError> {
        let Some(value) = headers.get("idempotency-key") else { return Ok(()) };
        let sane = |text: &&str| (1..=LONGEST_KEY).contains(&text.trim().len());
        let Some(text) = value.to_str().ok().filter(sane) else {
            return Err(ServerError::Option {
                name: "Idempotency-Key".to_owned(),
                problem: format!("expected 1 to {LONGEST_KEY} visible ASCII characters"),
            });
        };
        self.idempotency_key = Some(text.trim().to_owned());
        Ok(())
    }

    /// Checks what costs nothing, before a body is read.
    ///
    /// # Errors
    /// [`ServerError::Option`] for a callback that is not allowed.
    pub(crate) fn check(&self, callbacks: &CallbackPolicy) -> Result<(), ServerError> {
        let Some(url) = &self.callback_url else { return Ok(()) };
        callbacks
            .check(url)
            .map_err(|problem| ServerError::Option { name: "callback_url".to_owned(), problem })
    }
}

const NAMES: [&str; 3] = ["priority", "expires_s", "callback_url"];

#[cfg(test)]
mod tests {
    use super::*;

    fn query(text: &str) -> Result<(JobOptions, String), ServerError> {
        let mut options = JobOptions::default();
        let uri: Uri = format!("/jobs?{text}").parse().unwrap();
        let rest = options.take_query(&uri)?;
        Ok((options, rest.query().unwrap_or_default().to_owned()))
    }

    #[test]
    fn what_is_of_the_dance_stays() {
        let text = "seed=4&priority=-7&callback_url=https%3A%2F%2Fa.example%2Fb%3Fc&fps=30";
        let (options, rest) = query(text).unwrap();
        assert_eq!(options.priority, Some(-7));
        assert_eq!(options.callback_url.as_deref(), Some("https://a.example/b?c"));
        assert_eq!(rest, "seed=4&fps=30");
        assert_eq!(query("").unwrap(), (JobOptions::default(), String::new()));
    }

    #[test]
    fn what_means_nothing_is_refused() {
        for text in [
            "priority=101",
            "priority=-9223372036854775808",
            "priority=high",
            "priority=1&priority=1",
            "expires_s=0",
            "expires_s=NaN",
            "expires_s=1e9",
        ] {
            assert!(matches!(query(text), Err(ServerError::Option { .. })), "{text}");
        }
        for (key, good) in [("a b", true), ("", false), ("é", false), (&*"x".repeat(256), false)] {
            let mut headers = HeaderMap::new();
            headers.insert("idempotency-key", key.parse().unwrap());
            let read = JobOptions::default().take_headers(&headers);
            assert_eq!(read.is_ok(), good, "{key:?}");
        }
    }
}
