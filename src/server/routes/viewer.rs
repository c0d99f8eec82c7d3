//! The viewer at `/`: files built from `web/`, embedded in the binary.

use axum::{
    Router,
    extract::Path,
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Redirect, Response},
    routing::get,
};

use crate::server::{error::ServerError, layers::envelope::Held, options::shorten};

/// A built file: its path, its media type and its bytes.
struct Asset {
    path: &'static str,
    content_type: &'static str,
    bytes: &'static [u8],
}

macro_rules! assets {
    ($($path:literal: $content_type:literal),* $(,)?) => {
        &[$(Asset {
            path: $path,
            content_type: $content_type,
            bytes: include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/web/dist/", $path)),
        }),*]
    };
}

/// Every file of the build; a test compares the list with the folder.
const ASSETS: &[Asset] = assets! {
    "index.html": "text/html; charset=utf-8",
    "viewer/avatar.js": "text/javascript; charset=utf-8",
    "viewer/demo.mp3": "audio/mpeg",
    "viewer/film.js": "text/javascript; charset=utf-8",
    "viewer/gltf.js": "text/javascript; charset=utf-8",
    "viewer/icon.svg": "image/svg+xml",
    "viewer/index.css": "text/css; charset=utf-8",
    "viewer/index.js": "text/javascript; charset=utf-8",
    "viewer/licences.txt": "text/plain; charset=utf-8",
    "viewer/vrma.js": "text/javascript; charset=utf-8",
};

/// Hashes of the built files, which serve as their ETags: weak ones, for bytes are compressed on
/// the way.
const BUILD: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/web/dist/build.json"));

/// Scripts, styles and requests of this host only, none of them inline. `blob:` and `data:` are the
/// user's own song and character, which the page holds in memory.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    img-src 'self' blob: data:; media-src 'self' blob:; connect-src 'self' blob: data:; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The viewer at `/`; without it, `/` leads to the documentation.
pub(crate) fn routes(no_viewer: bool) -> Router {
    if no_viewer {
        return Router::new().route("/", get(|| async { Redirect::to("/docs/") }));
    }
    Router::new()
        .route("/", get(|headers: HeaderMap| async move { answer("index.html", &headers) }))
        .route("/viewer/{*file}", get(file))
}

async fn file(Path(file): Path<String>, headers: HeaderMap) -> Result<Response, ServerError> {
    answer(&format!("viewer/{file}"), &headers)
}

fn answer(path: &str, request: &HeaderMap) -> Result<Response, ServerError> {
    let asset = ASSETS.iter().find(|asset| asset.path == path);
    let asset =
        asset.ok_or_else(|| ServerError::NotFound { path: shorten(&format!("/{path}")) })?;
    let etag = etag(asset.path)?;
    let known = request.get_all(header::IF_NONE_MATCH).iter().any(|tags| {
        tags.to_str()
            .is_ok_and(|tags| tags.split(',').any(|tag| tag.trim() == etag || tag.trim() == "*"))
    });
    let headers = head(asset.content_type, &etag)?;
    Ok(match known {
        true => (StatusCode::NOT_MODIFIED, headers).into_response(),
        false => (Held::Shared, headers, asset.bytes).into_response(),
    })
}

/// # Errors
/// [`ServerError::Internal`] if the build does not name the file, which a test rules out.
fn etag(path: &str) -> Result<String, ServerError> {
    let build: serde_json::Value =
        serde_json::from_str(BUILD).map_err(|error| ServerError::Internal(error.to_string()))?;
    let hash = build["files"][path].as_str();
    let hash = hash.ok_or_else(|| ServerError::Internal(format!("{path} is not in the build")))?;
    Ok(format!("W/\"{hash}\""))
}

fn head(content_type: &'static str, etag: &str) -> Result<HeaderMap, ServerError> {
    let etag = HeaderValue::try_from(etag);
    let etag = etag.map_err(|error| ServerError::Internal(error.to_string()))?;
    let fixed = [
        (header::CONTENT_TYPE, content_type),
        // Asked for each time, answered with bytes only when they have changed.
        (header::CACHE_CONTROL, "no-cache"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("permissions-policy"), "microphone=(self), camera=()"),
    ];
    let mut headers: HeaderMap =
        fixed.map(|(name, value)| (name, HeaderValue::from_static(value))).into_iter().collect();
    headers.insert(header::ETAG, etag);
    Ok(headers)
}
