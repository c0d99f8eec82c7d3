//! What the table of jobs carries for the service: orders, results and errors, as JSON.

use std::{borrow::Cow, time::Duration};

use axum::http::StatusCode;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use sha2::{Digest, Sha256};
use uuid::Uuid;

use crate::{
    engine::MAX_SEED,
    formats::{GeneratedMotion, OutputFormat, Timings},
    server::{
        error::{Report, ServerError},
        options::RequestOptions,
    },
};

/// An order, as it was given.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct StoredOrder {
    /// Options of the dance, the seed always among them: a job that begins again makes the same.
    options: Vec<(Cow<'static, str>, String)>,
    /// Format that the result has unless another is asked for.
    format: Cow<'static, str>,
    /// Hash of what was sent: an idempotency key stands for one request only, whatever the model.
    pub(crate) fingerprint: String,
}

/// An order that is about to be stored, and what it is compared with others by.
pub(crate) struct Prepared {
    pub(crate) order: StoredOrder,
    /// Everything that determines the result.
    pub(crate) content_key: String,
    /// Whether the caller chose the seed, so that the same order means the same dance.
    pub(crate) repeats: bool,
}

impl StoredOrder {
    /// Prepares an order of a dance to a song, by its SHA-256, of at most `most_codes`. A seed that
    /// was left open is drawn here.
    pub(crate) fn prepare(
        options: &RequestOptions,
        format: OutputFormat,
        song: [u8; 32],
        model: &str,
        most_codes: usize,
    ) -> Prepared {
        let text = |name: &str, given: &str| match name {
            // Up to a megabyte as they came, and the table has thousands of orders.
            "codes" => options.shortest_codes(most_codes).unwrap_or_else(|| given.to_owned()),
            _ => given.to_owned(),
        };
        let mut pairs: Vec<(Cow<'static, str>, String)> = options
            .given()
            .iter()
            .filter(|(name, _)| *name != "format")
            .map(|(name, given)| (Cow::Borrowed(*name), text(name, given)))
            .collect();
        pairs.sort();
        let key = |pairs: &[(Cow<'static, str>, String)], model: Option<&str>| {
            let mut hash = Sha256::new();
            hash.update(song);
            let pairs = pairs.iter().flat_map(|(name, text)| [name.as_ref(), text]);
            // Lengths first, so that no two lists have the same bytes.
            for text in model.into_iter().chain([format.name()]).chain(pairs) {
                hash.update((text.len() as u64).to_le_bytes());
                hash.update(text);
            }
            hex(&hash.finalize())
        };
        // The caller did not send the model, which may be updated between two tries.
        let fingerprint = key(&pairs, None);
        let repeats = pairs.iter().any(|(name, _)| name == "seed");
        if !repeats {
            let seed = Uuid::new_v4().as_u128() % (u128::from(MAX_SEED) + 1);
            pairs.push((Cow::Borrowed("seed"), seed.to_string()));
            pairs.sort();
        }
        let content_key = key(&pairs, Some(model));
        let format = Cow::Borrowed(format.name());
        Prepared { order: Self { options: pairs, format, fingerprint }, content_key, repeats }
    }

    /// The options and the format.
    ///
    /// # Errors
    /// [`ServerError::Option`] for one that this release does not know.
    pub(crate) fn read(&self) -> Result<(RequestOptions, OutputFormat), ServerError> {
        let mut options = RequestOptions::default();
        for (name, text) in &self.options {
            options.set(name, text)?;
        }
        options.set("format", &self.format)?;
        let format = options.format.unwrap_or_default();
        Ok((options, format))
    }
}

/// What is known of a result beside its files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct StoredResult {
    /// Which start of the job it is of: its files are named by it.
    pub(crate) start: i64,
    pub(crate) seed: u64,
    pub(crate) tail: Option<String>,
    timings_us: [u64; 5],
    pub(crate) warnings: Vec<String>,
    /// Bytes of the file in the ordered format, where there is one.
    pub(crate) file_bytes: Option<u64>,
}

impl StoredResult {
    pub(crate) fn new(dance: &GeneratedMotion, start: i64, file_bytes: Option<u64>) -> Self {
        let Timings { queue, decode, features, inference, motion } = dance.timings;
        let micros = |time: Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        Self {
            start,
            seed: dance.seed,
            tail: dance.continuation.as_ref().map(crate::formats::Continuation::to_text),
            timings_us: [queue, decode, features, inference, motion].map(micros),
            warnings: dance.warnings.clone(),
            file_bytes,
        }
    }

    pub(crate) fn timings(&self) -> Timings {
        let [queue, decode, features, inference, motion] =
            self.timings_us.map(Duration::from_micros);
        Timings { queue, decode, features, inference, motion }
    }
}

/// Why a job has no result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct StoredError {
    status: u16,
    error_type: Cow<'static, str>,
    message: String,
    retry_after: Option<u64>,
}

impl StoredError {
    pub(crate) fn new(report: &Report) -> Self {
        Self {
            status: report.status.as_u16(),
            error_type: report.error_type.clone(),
            message: report.message.clone(),
            retry_after: report.retry_after,
        }
    }

    /// As the request that ordered the job would have been answered.
    pub(crate) fn report(self, request_id: &str) -> Report {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let report = Report {
            status,
            message: self.message,
            error_type: self.error_type,
            retry_after: self.retry_after,
            repeated: false,
        };
        report.repeated(request_id)
    }
}

/// As the table has it.
pub(crate) fn to_text(value: &impl Serialize) -> Result<String, ServerError> {
    serde_json::to_string(value).map_err(|error| ServerError::Internal(error.to_string()))
}

/// What the table has.
pub(crate) fn from_text<T: DeserializeOwned>(id: Uuid, text: &str) -> Result<T, ServerError> {
    let broken = |error| ServerError::Internal(format!("the record of job {id}: {error}"));
    serde_json::from_str(text).map_err(broken)
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prepared(options: &[(&str, &str)], audio: &[u8], model: &str) -> Prepared {
        let mut given = RequestOptions::default();
        for (name, text) in options {
            given.set(name, text).unwrap();
        }
        StoredOrder::prepare(&given, OutputFormat::Bvh, Sha256::digest(audio).into(), model, 3)
    }

    #[test]
    fn codes_are_kept_as_far_as_they_can_be_danced() {
        let spaced = format!("[[1, 2], [3,{}4]]", " ".repeat(9000));
        let long = "{\"codes\":{\"upper\":[1,3,5,7,9],\"lower\":[2,4,6,8,10]},\"positions\":[[]]}";
        for (given, count, kept) in [
            (spaced.as_str(), 2, "{\"upper\":[1,3],\"lower\":[2,4]}"),
            (long, 3, "{\"upper\":[1,3,5],\"lower\":[2,4,6]}"),
        ] {
            let order = prepared(&[("codes", given)], b"", "model").order;
            assert!(order.options.contains(&("codes".into(), kept.to_owned())), "{order:?}");
            assert_eq!(order.read().unwrap().0.given_codes(), Some(count));
        }
    }

    #[test]
    fn an_order_is_read_as_it_was_given_with_a_seed() {
        let one = prepared(&[("fps", "30"), ("bvh_unit", "m")], b"song", "model");
        let (options, format) = one.order.read().unwrap();
        assert_eq!((options.fps, format), (Some(30), OutputFormat::Bvh));
        assert!(!one.repeats && options.seed.is_some());
        let text = to_text(&one.order).unwrap();
        assert_eq!(from_text::<StoredOrder>(Uuid::nil(), &text).unwrap(), one.order);
        let other = prepared(&[("fps", "30"), ("bvh_unit", "m")], b"song", "model");
        assert_eq!(one.order.fingerprint, other.order.fingerprint);
        assert_ne!(one.content_key, other.content_key, "each has a seed of its own");
        let updated = prepared(&[("fps", "30"), ("bvh_unit", "m")], b"song", "another");
        assert_eq!(one.order.fingerprint, updated.order.fingerprint);
        for (options, audio) in [(("fps", "24"), &b"song"[..]), (("fps", "30"), b"sung")] {
            let changed = prepared(&[options, ("bvh_unit", "m")], audio, "model");
            assert_ne!(one.order.fingerprint, changed.order.fingerprint);
        }
    }

    #[test]
    fn the_same_order_has_the_same_key_and_no_other_has() {
        let key = |options: &[(&str, &str)], audio: &[u8], model| {
            prepared(options, audio, model).content_key
        };
        let one = key(&[("seed", "1"), ("fps", "30")], b"song", "model");
        assert_eq!(one, key(&[("fps", "30"), ("seed", "1")], b"song", "model"));
        assert_ne!(one, key(&[("fps", "24"), ("seed", "1")], b"song", "model"));
        assert_ne!(one, key(&[("fps", "30"), ("seed", "1")], b"sung", "model"));
        assert_ne!(one, key(&[("fps", "30"), ("seed", "1")], b"song", "other"));
    }

    #[test]
    fn an_error_is_answered_as_it_was_met() {
        let report = ServerError::MissingAudio.report();
        let text = to_text(&StoredError::new(&report)).unwrap();
        let read = from_text::<StoredError>(Uuid::nil(), &text).unwrap().report("r");
        assert_eq!((read.status, &read.error_type), (report.status, &report.error_type));
        assert!(read.repeated && read.message.contains("(of the request r)"));
        assert!(from_text::<StoredError>(Uuid::nil(), "{").is_err());
    }
}
