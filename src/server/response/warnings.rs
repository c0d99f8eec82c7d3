//! Warnings as headers, for formats that have no place for them.

use axum::http::{HeaderMap, HeaderName, HeaderValue};

const WARNINGS: HeaderName = HeaderName::from_static("x-warnings");
/// Most warnings that are sent; of more, the last header says how many were left out.
const MOST: usize = 8;
/// Longest text of one warning in bytes.
const LONGEST: usize = 200;

/// Adds one header for each warning.
pub(crate) fn append(headers: &mut HeaderMap, warnings: &[String]) {
    let shown = if warnings.len() > MOST { MOST - 1 } else { warnings.len() };
    let unshown = warnings.len() - shown;
    let rest = (unshown > 0).then(|| format!("and {unshown} more"));
    for warning in warnings.iter().take(shown).chain(&rest) {
        if let Ok(value) = HeaderValue::try_from(plain(warning)) {
            headers.append(WARNINGS, value);
        }
    }
}

/// Printable ASCII: a warning may repeat what a file says about itself.
fn plain(text: &str) -> String {
    let printable = |c: char| c == ' ' || c.is_ascii_graphic();
    text.chars().map(|c| if printable(c) { c } else { '?' }).take(LONGEST).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(warnings: &[String]) -> Vec<String> {
        let mut headers = HeaderMap::new();
        append(&mut headers, warnings);
        let values = headers.get_all(WARNINGS).iter();
        values.map(|value| value.to_str().unwrap().to_owned()).collect()
    }

    #[test]
    fn every_warning_is_a_header_of_its_own() {
        assert!(sent(&[]).is_empty());
        let two = ["one".to_owned(), "two, with a comma".to_owned()];
        assert_eq!(sent(&two), two);
    }

    #[test]
    fn text_and_number_are_bounded_and_plain() {
        let odd = "tag \u{e9}\r\nx-evil: 1".to_owned();
        assert_eq!(sent(&[odd]), ["tag ???x-evil: 1"]);
        assert_eq!(sent(&["x".repeat(10_000)])[0].len(), LONGEST);
        let many: Vec<String> = (0..100).map(|i| i.to_string()).collect();
        let sent = sent(&many);
        assert_eq!(sent.len(), MOST);
        assert_eq!(sent[MOST - 1], "and 93 more");
    }
}
