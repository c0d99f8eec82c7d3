//! The OpenAPI document: made of the handlers, committed at `openapi/openapi.json`.

use utoipa::{
    Modify, OpenApi,
    openapi::security::{ApiKey, ApiKeyValue, Http, HttpAuthScheme, SecurityScheme},
};
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    error::ErrorEvent,
    routes::{codes, generate, jobs, probes, stream},
    state::SharedState,
};
use crate::formats::{DoneJson, FramesJson, StartJson};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "bailando",
        description = "Music in, 3-D dance out. Every error has the same shape, `ErrorBody`; every answer carries `x-request-id`, which is taken over if sent, and `x-total-time` in milliseconds.",
    ),
    tags(
        (name = "dance", description = "Audio in, dance out."),
        (name = "jobs", description = "Dances that are ordered now and fetched later."),
        (name = "codes", description = "What the pose codes look like."),
        (name = "probes", description = "Is it there, and what is it."),
    ),
    components(schemas(StartJson<'_>, FramesJson<'_>, DoneJson<'_>, ErrorEvent)),
    modifiers(&Keys)
)]
struct Document;

/// Routes that everybody may call, with what the document says of the whole.
pub(crate) fn documented() -> OpenApiRouter<SharedState> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(probes::health))
        .routes(routes!(probes::ready))
        .routes(routes!(probes::info))
        .routes(routes!(probes::metrics))
}

/// Routes that work, for those who are let in.
pub(crate) fn working() -> OpenApiRouter<SharedState> {
    OpenApiRouter::new()
        .routes(routes!(generate::generate))
        .routes(routes!(stream::stream))
        .routes(routes!(jobs::create))
        .routes(routes!(jobs::status, jobs::delete))
        .routes(routes!(jobs::result))
        .routes(routes!(codes::codebooks))
        .routes(routes!(codes::pose))
}

/// The ways to send an API key.
struct Keys;

impl Modify for Keys {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let components = document.components.get_or_insert_default();
        components.add_security_scheme(
            "bearer",
            SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer)),
        );
        components.add_security_scheme(
            "api_key",
            SecurityScheme::ApiKey(ApiKey::Header(ApiKeyValue::new("x-api-key"))),
        );
    }
}

/// The OpenAPI document as it is committed: indented JSON with a final newline.
///
/// # Errors
/// None that is known; writing JSON is fallible by its type.
pub fn openapi_json() -> serde_json::Result<String> {
    let mut json = serde_json::to_string_pretty(documented().merge(working()).get_openapi())?;
    json.push('\n');
    Ok(json)
}
