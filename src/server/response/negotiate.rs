//! The format of a response, from the Accept header.

use axum::http::{HeaderMap, header};

use crate::{
    formats::OutputFormat,
    server::{
        error::ServerError,
        options::shorten,
        response::{
            accept::{quality_of_type, ranges},
            encoding::Encoding,
        },
    },
};

/// How a response is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    pub(crate) format: OutputFormat,
    /// Content coding of a whole answer.
    pub(crate) encoding: Encoding,
    /// Whether a stream is written as lines of JSON, not as server-sent events.
    pub(crate) lines: bool,
}

/// Media type of server-sent events.
pub(crate) const EVENTS: &str = "text/event-stream";
/// Media type of JSON in lines.
pub(crate) const LINES: &str = "application/x-ndjson";

/// Returns the format that an `Accept` header prefers (RFC 9110, section 12.5.1), or `otherwise`
/// where it has no preference.
///
/// # Errors
/// [`ServerError::NotAcceptable`] when none of ours is accepted.
pub(crate) fn dance(
    headers: &HeaderMap,
    otherwise: OutputFormat,
) -> Result<OutputFormat, ServerError> {
    let mut ours = OutputFormat::ALL;
    ours.sort_by_key(|format| *format != otherwise);
    let best = preferred(headers, &ours.map(OutputFormat::content_type))?;
    Ok(ours.get(best).copied().unwrap_or(otherwise))
}

/// Returns whether the `Accept` header prefers lines of JSON to server-sent events.
///
/// # Errors
/// [`ServerError::NotAcceptable`] when it accepts neither.
pub(crate) fn events_as_lines(headers: &HeaderMap) -> Result<bool, ServerError> {
    Ok(preferred(headers, &[EVENTS, LINES])? == 1)
}

/// Returns the index in `ours` that an `Accept` header prefers; 0 where it has no preference.
fn preferred(headers: &HeaderMap, ours: &[&str]) -> Result<usize, ServerError> {
    let ranges = ranges(headers, &header::ACCEPT);
    if ranges.is_empty() {
        return Ok(0);
    }
    let mut best: Option<(f32, usize)> = None;
    for (index, content_type) in ours.iter().enumerate() {
        let quality = quality_of_type(&ranges, content_type);
        if quality > 0.0 && best.is_none_or(|(so_far, _)| quality > so_far) {
            best = Some((quality, index));
        }
    }
    best.map(|(_, index)| index).ok_or_else(|| ServerError::NotAcceptable {
        asked: shorten(
            headers.get(header::ACCEPT).and_then(|value| value.to_str().ok()).unwrap_or_default(),
        ),
        available: {
            // Two formats may have one type.
            let mut types = ours.to_vec();
            types.dedup();
            types.join(", ")
        },
    })
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn accept(text: &'static str) -> Option<OutputFormat> {
        let mut headers = HeaderMap::new();
        headers.insert(header::ACCEPT, HeaderValue::from_static(text));
        dance(&headers, OutputFormat::Json).ok()
    }

    #[test]
    fn the_preferred_type_that_we_have_wins() {
        let bvh = OutputFormat::Bvh.content_type();
        let silent = HeaderMap::new();
        for otherwise in OutputFormat::ALL {
            assert_eq!(dance(&silent, otherwise).ok(), Some(otherwise));
        }
        assert_eq!(accept("*/*"), Some(OutputFormat::Json));
        assert_eq!(accept(""), Some(OutputFormat::Json));
        assert_eq!(accept("application/json"), Some(OutputFormat::Json));
        assert_eq!(accept("Application/JSON; q=0.3"), Some(OutputFormat::Json));
        assert_eq!(accept("text/html, */*;q=0.1"), Some(OutputFormat::Json));
        assert_eq!(accept("application/json;q=0, */*"), Some(OutputFormat::Bvh));
        assert_eq!(accept("model/gltf-binary"), Some(OutputFormat::Glb));
        assert_eq!(accept("model/gltf-binary, application/json;q=0.9"), Some(OutputFormat::Glb));
        assert_eq!(accept("video/mp4"), None);
        assert_eq!(accept("*/*;q=0"), None);
        let mut headers = HeaderMap::new();
        let both = format!("application/json;q=0.5, {bvh}");
        headers.insert(header::ACCEPT, both.parse().unwrap());
        let preferred = dance(&headers, OutputFormat::Json);
        assert_eq!(preferred.ok(), Some(OutputFormat::Bvh));
        headers.insert(header::ACCEPT, HeaderValue::from_static("application/*"));
        let either = dance(&headers, OutputFormat::Bvh);
        assert_eq!(either.ok(), Some(OutputFormat::Bvh));
        headers.insert(header::ACCEPT, HeaderValue::from_static("model/gltf-binary"));
        let avatar = dance(&headers, OutputFormat::Vrma);
        assert_eq!(avatar.ok(), Some(OutputFormat::Vrma));
    }

    #[test]
    fn events_are_lines_where_lines_are_preferred() {
        let lines = |text: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT, HeaderValue::from_static(text));
            events_as_lines(&headers).ok()
        };
        assert_eq!(events_as_lines(&HeaderMap::new()).ok(), Some(false));
        assert_eq!(lines("*/*"), Some(false));
        assert_eq!(lines("text/event-stream"), Some(false));
        assert_eq!(lines("application/x-ndjson"), Some(true));
        assert_eq!(lines("application/x-ndjson, text/event-stream;q=0.5"), Some(true));
        assert_eq!(lines("application/json"), None);
    }
}
