//! Headers that say what is accepted, and how gladly.

use axum::http::{HeaderMap, HeaderName, header};

/// Returns the quality of a content coding in the `Accept-Encoding` headers (RFC 9110, section
/// 12.5.3); 0 where it is not accepted.
pub(super) fn quality_of_coding(headers: &HeaderMap, coding: &str) -> f32 {
    let ranges = ranges(headers, &header::ACCEPT_ENCODING);
    let of = |name: &str| ranges.iter().find(|range| range.kind == name);
    of(coding).or_else(|| of("*")).map_or(0.0, |range| range.quality)
}

/// The ranges of all headers of a name.
pub(super) fn ranges(headers: &HeaderMap, name: &HeaderName) -> Vec<Range> {
    let values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).filter_map(Range::parse).collect()
}

/// One range of an accepting header with its quality.
pub(super) struct Range {
    kind: String,
    quality: f32,
}

impl Range {
    fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split(';').map(str::trim);
        let kind = parts.next()?.to_ascii_lowercase();
        if kind.is_empty() {
            return None;
        }
        let quality = parts
            .find_map(|part| part.strip_prefix("q=").or_else(|| part.strip_prefix("Q=")))
            .map_or(Some(1.0), |text| text.parse().ok())?;
        Some(Self { kind, quality })
    }

    /// Returns how closely the range names `content_type`; none if it does not cover it.
    fn specificity(&self, content_type: &str) -> Option<u8> {
        if self.kind == content_type {
            Some(2)
        } else if self.kind == "*/*" {
            Some(0)
        } else {
            let family = self.kind.strip_suffix("/*")?;
            (content_type.split('/').next() == Some(family)).then_some(1)
        }
    }
}

/// Returns the quality of `content_type` in the most specific range that covers it; 0 where it is
/// not accepted.
pub(super) fn quality_of_type(ranges: &[Range], content_type: &str) -> f32 {
    ranges
        .iter()
        .filter_map(|range| Some((range.specificity(content_type)?, range.quality)))
        .max_by_key(|(specificity, _)| *specificity)
        .map_or(0.0, |(_, quality)| quality)
}
