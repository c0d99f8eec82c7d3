//! The OpenAPI document: made of the handlers, committed at `openapi/openapi.json`.

use utoipa::OpenApi;
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    routes::{generate, probes},
    state::SharedState,
};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "bailando",
        description = "Music in, 3-D dance out. Every error has the same shape, `ErrorBody`; every answer carries `x-request-id`, which is taken over if sent, and `x-total-time` in milliseconds.",
    ),
    tags(
        (name = "dance", description = "Audio in, dance out."),
        (name = "probes", description = "Is it there, and what is it."),
    )
)]
struct Document;

/// The documented routes, and their document.
pub(crate) fn documented() -> OpenApiRouter<SharedState> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(generate::generate))
        .routes(routes!(probes::health))
        .routes(routes!(probes::ready))
        .routes(routes!(probes::info))
}

/// The OpenAPI document as it is committed: indented JSON with a final newline.
///
/// # Errors
/// None that is known; writing JSON is fallible by its type.
pub fn openapi_json() -> serde_json::Result<String> {
    let mut json = serde_json::to_string_pretty(documented().get_openapi())?;
    json.push('\n');
    Ok(json)
}
