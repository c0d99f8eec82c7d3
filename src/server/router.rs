//! All routes in their layers.

use std::sync::Arc;

use super::{
    config::{Access, Limits, Role},
    error::ServerError,
    jobs::owners::Owners,
    layers::{auth, cors, envelope},
    metrics::SharedMetrics,
    openapi,
    options::shorten,
    response::{
        encoding::Encoding,
        negotiate::{EVENTS, LINES},
    },
    routes::{docs, viewer},
    state::{Generate, ServerState, SharedState},
};
use axum::{
    Router,
    extract::Request,
    http::{Extensions, HeaderMap, Method, StatusCode, Uri, Version},
    middleware::{self, Next},
    response::{IntoResponse, Response},
};
use tower_http::{
    CompressionLevel,
    compression::{
        CompressionLayer, Predicate,
        predicate::{NotForContentType, SizeAbove},
    },
};

/// Smallest response that is compressed.
const SMALLEST_COMPRESSED: u64 = 1024;

/// The whole service over `engine`, without a listener: what tests drive.
pub fn router(engine: Arc<dyn Generate>, limits: Limits, access: Access) -> Router {
    let state = ServerState::loading(limits, SharedMetrics::default());
    state.finish_loading(engine);
    router_with(state, &access)
}

pub(crate) fn router_with(state: SharedState, access: &Access) -> Router {
    state.jobs.owners.get_or_init(|| Owners::new(&access.keys));
    let gate = Arc::new(auth::Gate::new(access, &state.limits));
    // Before anything of a body is read.
    let auth = middleware::from_fn_with_state(gate, auth::admit);
    let (routes, document) =
        openapi::public_routes().merge(openapi::keyed_routes().route_layer(auth)).split_for_parts();
    let role = state.role;
    let routes = routes
        .with_state(Arc::clone(&state))
        .route_layer(middleware::from_fn(move |request: Request, next: Next| {
            of_role(role, request, next)
        }))
        .merge(docs::routes(&document))
        .merge(viewer::routes(access.no_viewer))
        .fallback(not_found)
        .method_not_allowed_fallback(method_not_allowed);
    let routes = envelope::wrap(routes, state, &access.hosts);
    let routes = routes.layer(compression());
    match access.origins.is_empty() {
        true => routes,
        false => routes.layer(cors::layer(&access.origins)),
    }
}

/// Compresses documents for clients that ask for it. Dances are compressed where they are written,
/// off the threads that serve connections, and events are sent as they come, which a compressor
/// would hold back.
fn compression() -> CompressionLayer<impl Predicate> {
    let kinds = SizeAbove::new(SMALLEST_COMPRESSED)
        .and(NotForContentType::const_new(EVENTS))
        .and(NotForContentType::const_new(LINES))
        .and(NotForContentType::IMAGES)
        .and(|_: StatusCode, _: Version, _: &HeaderMap, extensions: &Extensions| {
            extensions.get::<Encoding>().is_none()
        });
    CompressionLayer::new().quality(CompressionLevel::Fastest).compress_when(kinds)
}

/// Answers what a process of this role has for others to do.
async fn of_role(role: Role, request: Request, next: Next) -> Response {
    let path = request.uri().path();
    let below = |prefix: &str| {
        path.strip_prefix(prefix).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    };
    let needs_model = below("/generate") || below("/codes");
    match role {
        Role::Api if needs_model => ServerError::NoModel.into_response(),
        Role::Worker if needs_model || below("/jobs") => ServerError::NoJobs.into_response(),
        _ => next.run(request).await,
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
