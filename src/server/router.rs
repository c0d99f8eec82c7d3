//! All routes in their layers.

use std::sync::Arc;

use axum::{
    Router,
    extract::Request,
    http::{Method, Uri},
};
use utoipa_swagger_ui::SwaggerUi;

use super::{
    config::Limits,
    envelope,
    error::ServerError,
    openapi,
    options::shorten,
    state::{Generate, ServerState, SharedState},
};

/// The whole service over `engine`, without a listener: what tests drive.
pub fn router(engine: Arc<dyn Generate>, limits: Limits) -> Router {
    router_with(ServerState::new(engine, limits))
}

pub(crate) fn router_with(state: SharedState) -> Router {
    let (routes, document) = openapi::documented().split_for_parts();
    let docs = SwaggerUi::new("/docs").url("/api-doc/openapi.json", document);
    let routes = routes
        .with_state(state)
        .merge(docs)
        .fallback(not_found)
        .method_not_allowed_fallback(method_not_allowed);
    envelope::wrap(routes)
}

async fn not_found(uri: Uri) -> ServerError {
    ServerError::NotFound {
        path: shorten(uri.path()),
    }
}

async fn method_not_allowed(method: Method, request: Request) -> ServerError {
    ServerError::MethodNotAllowed {
        path: shorten(request.uri().path()),
        method: shorten(method.as_str()),
    }
}
