//! Parts of a result (RFC 9110, section 14).

use std::ops::Range;

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};

use crate::server::error::ServerError;

/// The part of `size` bytes that a request asks for; none for all of them: several ranges, a unit
/// of another kind, or bytes of another version that the client has a part of.
///
/// # Errors
/// [`ServerError::Range`] for bytes that are not there.
pub(super) fn asked(
    headers: &HeaderMap,
    tag: &HeaderValue,
    size: u64,
) -> Result<Option<Range<u64>>, ServerError> {
    let other = headers.get(header::IF_RANGE).is_some_and(|version| version != tag);
    let range = headers.get(header::RANGE).and_then(|range| range.to_str().ok());
    let Some((first, last)) = range
        .filter(|_| !other)
        .and_then(|range| range.strip_prefix("bytes="))
        .filter(|range| !range.contains(','))
        .and_then(|range| range.trim().split_once('-'))
    else {
        return Ok(None);
    };
    let number = |text: &str| text.parse::<u64>().ok();
    let part = match (number(first), number(last)) {
        (Some(first), Some(last)) if first <= last => first..last.saturating_add(1).min(size),
        (Some(first), None) if last.is_empty() => first..size,
        (None, Some(count)) if first.is_empty() => size.saturating_sub(count)..size,
        _ => return Ok(None),
    };
    match part.is_empty() {
        true => Err(ServerError::Range { size }),
        false => Ok(Some(part)),
    }
}

/// Describes what is sent; the status that it has.
pub(super) fn describe(
    headers: &mut HeaderMap,
    tag: &HeaderValue,
    part: Option<Range<u64>>,
    size: u64,
) -> StatusCode {
    headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    headers.insert(header::ETAG, tag.clone());
    let Some(part) = part else {
        headers.insert(header::CONTENT_LENGTH, HeaderValue::from(size));
        return StatusCode::OK;
    };
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(part.end - part.start));
    let range = format!("bytes {}-{}/{size}", part.start, part.end - 1);
    if let Ok(range) = HeaderValue::try_from(range) {
        headers.insert(header::CONTENT_RANGE, range);
    }
    StatusCode::PARTIAL_CONTENT
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(range: &'static str, version: Option<&'static str>) -> Option<Range<u64>> {
        let mut headers = HeaderMap::new();
        headers.insert(header::RANGE, HeaderValue::from_static(range));
        if let Some(version) = version {
            headers.insert(header::IF_RANGE, HeaderValue::from_static(version));
        }
        asked(&headers, &HeaderValue::from_static("\"v\""), 10).unwrap_or(Some(0..0))
    }

    #[test]
    fn one_range_of_bytes_is_given() {
        for (range, part) in [
            ("bytes=0-0", Some(0..1)),
            ("bytes=3-99", Some(3..10)),
            ("bytes=9-", Some(9..10)),
            ("bytes=-4", Some(6..10)),
            ("bytes=-99", Some(0..10)),
            ("bytes=10-", Some(0..0)),
            ("bytes=-0", Some(0..0)),
            ("bytes=4-3", None),
            ("bytes=0-1,3-4", None),
            ("frames=0-1", None),
            ("bytes=x-1", None),
            ("bytes=-", None),
        ] {
            assert_eq!(ask(range, None), part, "{range}");
        }
        assert_eq!(ask("bytes=1-2", Some("\"v\"")), Some(1..3));
        assert_eq!(ask("bytes=1-2", Some("\"w\"")), None);
    }
}
