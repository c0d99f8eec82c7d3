//! All routes in their layers.

use std::sync::Arc;

use axum::{
    Router,
    extract::Request,
    http::{Method, StatusCode, Uri},
    middleware,
    response::{IntoResponse, Response},
};
use tower_http::cors::{AllowHeaders, AllowOrigin, Any, CorsLayer};
use utoipa_swagger_ui::SwaggerUi;

use super::{
    access::{self, Access},
    config::{Limits, Origin},
    envelope,
    error::ServerError,
    metrics::SharedMetrics,
    openapi,
    options::shorten,
    state::{Generate, ServerState, SharedState},
};

/// The whole service over `engine`, without a listener: what tests drive.
pub fn router(engine: Arc<dyn Generate>, limits: Limits, access: Access) -> Router {
    let state = ServerState::loading(limits, access, SharedMetrics::default());
    state.finish_loading(engine);
    router_with(state)
}

pub(crate) fn router_with(state: SharedState) -> Router {
    let working = openapi::working();
    // Whoever is not let in is told so before anything of the body is read.
    let let_in = middleware::from_fn_with_state(Arc::clone(&state), access::admit);
    let (routes, document) = openapi::documented()
        .merge(working.route_layer(let_in))
        .split_for_parts();
    let docs = SwaggerUi::new("/docs").url("/api-doc/openapi.json", document);
    let cors = cors(&state.access.origins);
    let routes = routes
        .with_state(Arc::clone(&state))
        .merge(docs)
        .fallback(not_found)
        .method_not_allowed_fallback(method_not_allowed);
    let routes = envelope::wrap(routes, &state);
    match cors {
        Some(cors) => routes.layer(cors),
        None => routes,
    }
}

/// Lets pages of these origins call, and read what an answer's head says.
fn cors(origins: &[Origin]) -> Option<CorsLayer> {
    if origins.is_empty() {
        return None;
    }
    let allowed = match origins.iter().any(Origin::is_any) {
        true => AllowOrigin::any(),
        false => AllowOrigin::list(origins.iter().map(Origin::header)),
    };
    let layer = CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
        // By name: a `*` does not cover `Authorization`.
        .allow_headers(AllowHeaders::mirror_request())
        .expose_headers(Any);
    Some(layer)
}

async fn not_found(uri: Uri) -> ServerError {
    ServerError::NotFound {
        path: shorten(uri.path()),
    }
}

/// `Allow` is added by the router.
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
