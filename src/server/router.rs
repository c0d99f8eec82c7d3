//! All routes in their layers.

use std::sync::Arc;

use super::{
    config::{Access, Limits},
    error::ServerError,
    layers::{auth, cors, envelope},
    metrics::SharedMetrics,
    openapi,
    options::shorten,
    routes::docs,
    state::{Generate, ServerState, SharedState},
};
use axum::{
    Router,
    extract::Request,
    http::{Method, StatusCode, Uri},
    middleware,
    response::{IntoResponse, Response},
};

/// The whole service over `engine`, without a listener: what tests drive.
pub fn router(engine: Arc<dyn Generate>, limits: Limits, access: Access) -> Router {
    let state = ServerState::loading(limits, SharedMetrics::default());
    state.finish_loading(engine);
    router_with(state, &access)
}

pub(crate) fn router_with(state: SharedState, access: &Access) -> Router {
    let gate = Arc::new(auth::Gate::new(access, &state.limits));
    // Before anything of a body is read.
    let auth = middleware::from_fn_with_state(gate, auth::admit);
    let (routes, document) =
        openapi::public_routes().merge(openapi::keyed_routes().route_layer(auth)).split_for_parts();
    let routes = routes
        .with_state(Arc::clone(&state))
        .merge(docs::routes(&document))
        .fallback(not_found)
        .method_not_allowed_fallback(method_not_allowed);
    let routes = envelope::wrap(routes, state, &access.hosts);
    match access.origins.is_empty() {
        true => routes,
        false => routes.layer(cors::layer(&access.origins)),
    }
}

async fn not_found(uri: Uri) -> ServerError {
    ServerError::NotFound { path: shorten(uri.path()) }
}

/// Answers a wrong method; the router adds `Allow`.
async fn method_not_allowed(method: Method, request: Request) -> Response {
    if method == Method::OPTIONS {
        return StatusCode::NO_CONTENT.into_response();
    }
    ServerError::MethodNotAllowed {
        path: shorten(request.uri().path()),
        method: shorten(method.as_str()),
    }
    .into_response()
}
