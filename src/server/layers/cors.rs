//! Pages of other origins that may call (CORS).

use axum::http::Method;
use tower_http::cors::{AllowHeaders, AllowOrigin, Any, CorsLayer};

use crate::server::config::Origin;

/// Lets pages of `origins` call, and read the headers of responses.
pub(crate) fn layer(origins: &[Origin]) -> CorsLayer {
    let allowed = match origins.iter().any(Origin::is_any) {
        true => AllowOrigin::any(),
        false => AllowOrigin::list(origins.iter().map(Origin::header)),
    };
    CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
        // By name: a `*` does not cover `Authorization`.
        .allow_headers(AllowHeaders::mirror_request())
        .expose_headers(Any)
}
