//! The kind of body that a request has, from its headers.

use axum::http::{HeaderMap, header};

use crate::server::{error::ServerError, options::shorten};

/// Fields of a form without files.
const URLENCODED: &str = "application/x-www-form-urlencoded";

/// How the audio is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Media {
    /// The body is the audio.
    Raw,
    /// The audio is part `file` of a form.
    Form,
}

impl Media {
    /// Reads `Content-Type` and `Content-Encoding`. The audio's kind is read from its bytes: phones
    /// and browsers call it `video/webm`, `application/x-flac` and much else.
    ///
    /// # Errors
    /// [`ServerError::UnsupportedMedia`] for compressed bodies and for types that mean something
    /// else than a file.
    pub(crate) fn of(headers: &HeaderMap) -> Result<Self, ServerError> {
        let text = |name| {
            headers
                .get(name)
                .map(|value| String::from_utf8_lossy(value.as_bytes()).to_ascii_lowercase())
        };
        if let Some(encoding) = text(header::CONTENT_ENCODING)
            && encoding.trim() != "identity"
        {
            return Err(ServerError::UnsupportedMedia(format!(
                "content encoding {:?} is not accepted: send the audio file as it is",
                shorten(&encoding)
            )));
        }
        let Some(content_type) = text(header::CONTENT_TYPE) else {
            return Ok(Self::Raw);
        };
        let kind = content_type.split(';').next().unwrap_or_default().trim();
        match kind {
            "multipart/form-data" => Ok(Self::Form),
            "text/html" | "application/json" => Err(ServerError::UnsupportedMedia(refusal(kind))),
            URLENCODED => {
                let hint = "`curl --data-binary` says so of itself: add -H 'Content-Type: \
                            audio/mpeg', or send -F file=@song.mp3";
                Err(ServerError::UnsupportedMedia(format!("{} ({hint})", refusal(kind))))
            }
            _ if kind.starts_with("multipart/") || kind.ends_with("+json") => {
                Err(ServerError::UnsupportedMedia(refusal(kind)))
            }
            _ => Ok(Self::Raw),
        }
    }
}

fn refusal(kind: &str) -> String {
    format!(
        "content type {:?} is not accepted: send multipart/form-data with part `file`, or audio/* \
         or application/octet-stream",
        shorten(kind)
    )
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn media(name: header::HeaderName, value: &'static str) -> Option<Media> {
        let mut headers = HeaderMap::new();
        headers.insert(name, HeaderValue::from_static(value));
        Media::of(&headers).ok()
    }

    #[test]
    fn audio_and_forms_are_accepted_and_compression_is_not() {
        assert_eq!(Media::of(&HeaderMap::new()).ok(), Some(Media::Raw));
        let of = |value| media(header::CONTENT_TYPE, value);
        assert_eq!(of("Audio/MPEG; codecs=mp3"), Some(Media::Raw));
        for kind in
            ["video/webm;codecs=opus", "application/x-flac", "text/plain", "image/png", "whatever"]
        {
            assert_eq!(of(kind), Some(Media::Raw), "{kind}");
        }
        assert_eq!(of("multipart/form-data; boundary=x"), Some(Media::Form));
        assert_eq!(of("multipart/mixed; boundary=x"), None);
        assert_eq!(of("application/json; charset=utf-8"), None);
        assert_eq!(of("application/problem+json"), None);
        assert_eq!(of("text/html"), None);
        assert_eq!(of("application/x-www-form-urlencoded; charset=utf-8"), None);
        assert_eq!(media(header::CONTENT_ENCODING, "gzip"), None);
        assert_eq!(media(header::CONTENT_ENCODING, "identity"), Some(Media::Raw));
    }
}
