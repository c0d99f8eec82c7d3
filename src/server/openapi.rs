//! The OpenAPI document: made of the handlers, committed at `openapi/openapi.json`.

use utoipa::{
    Modify, OpenApi, ToSchema,
    openapi::{
        ContentBuilder, Ref,
        path::Operation,
        request_body::{RequestBody, RequestBodyBuilder},
        security::{
            ApiKey, ApiKeyValue, Http, HttpAuthScheme, SecurityRequirement, SecurityScheme,
        },
    },
};
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    error::{ErrorBody, ErrorEvent},
    options::{AudioFile, GenerateForm},
    routes::{codes, generate, jobs, probes, stream},
    state::SharedState,
};
use crate::formats::{DoneJson, FramesJson, MotionJson, StartJson};

/// Names of the two ways to send an API key.
const SCHEMES: [&str; 2] = ["bearer", "api_key"];
/// Operations that take a song.
const TAKE_SONGS: [&str; 4] = ["generate_motion", "generate_file", "stream_motion", "create_job"];

#[derive(OpenApi)]
#[openapi(
    info(
        title = "bailando",
        description = "Music in, 3-D dance out. Every error has the same shape, `ErrorBody`; every \
            response carries `x-request-id`, which is kept if sent, and `x-total-time` in \
            milliseconds.",
    ),
    tags(
        (name = "dance", description = "Audio in, motion out."),
        (name = "jobs", description = "Motion that is requested now and fetched later."),
        (name = "codes", description = "The motion of each pose code."),
        (name = "probes", description = "State and description of the service."),
    ),
    components(schemas(
        StartJson<'_>, FramesJson<'_>, DoneJson<'_>, ErrorEvent,
        MotionJson<'_>, ErrorBody, AudioFile, GenerateForm
    )),
    modifiers(&Schemes)
)]
struct Document;

/// Routes that need no key, with the general part of the document.
pub(crate) fn public_routes() -> OpenApiRouter<SharedState> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(probes::health))
        .routes(routes!(probes::ready))
        .routes(routes!(probes::info))
        .routes(routes!(probes::metrics))
}

/// Routes that need a key, where the server has keys.
pub(crate) fn keyed_routes() -> OpenApiRouter<SharedState> {
    let mut router = OpenApiRouter::new()
        .routes(routes!(generate::generate))
        .routes(routes!(generate::generate_file))
        .routes(routes!(stream::stream))
        .routes(routes!(jobs::create::create, jobs::manage::list))
        .routes(routes!(jobs::manage::status, jobs::manage::delete))
        .routes(routes!(jobs::result::result))
        .routes(routes!(jobs::events::events))
        .routes(routes!(codes::codebooks))
        .routes(routes!(codes::pose));
    for path in router.get_openapi_mut().paths.paths.values_mut() {
        let operations = [&mut path.get, &mut path.post, &mut path.delete];
        for operation in operations.into_iter().flatten() {
            complete(operation);
        }
    }
    router
}

/// Adds to an operation what many have in common: the API key, and the song as its body.
fn complete(operation: &mut Operation) {
    let none = SecurityRequirement::default();
    let keys = SCHEMES.map(|name| SecurityRequirement::new(name, Vec::<String>::new()));
    operation.security = Some([none].into_iter().chain(keys).collect());
    let id = operation.operation_id.as_deref();
    if id.is_some_and(|id| TAKE_SONGS.contains(&id)) {
        operation.request_body = Some(song().into());
    }
}

fn song() -> RequestBody {
    let content = |schema| {
        let schema = Ref::from_schema_name(schema);
        ContentBuilder::new().schema(Some(schema)).build()
    };
    RequestBodyBuilder::new()
        .description(Some(
            "The song: wav, aiff, flac, mp3, ogg, webm (vorbis, opus) or m4a (aac, alac), \
             recognised by its bytes.",
        ))
        .content("multipart/form-data", content(GenerateForm::name()))
        .content("audio/*", content(AudioFile::name()))
        .content("application/octet-stream", content(AudioFile::name()))
        .required(Some(utoipa::openapi::Required::True))
        .build()
}

/// Describes the ways to send an API key.
struct Schemes;

impl Modify for Schemes {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let components = document.components.get_or_insert_default();
        let [bearer, api_key] = SCHEMES;
        let http = Http::new(HttpAuthScheme::Bearer);
        components.add_security_scheme(bearer, SecurityScheme::Http(http));
        let header = ApiKey::Header(ApiKeyValue::new("x-api-key"));
        components.add_security_scheme(api_key, SecurityScheme::ApiKey(header));
    }
}

/// Returns the OpenAPI document as it is committed: indented JSON with a final newline.
///
/// # Errors
/// None that is known; writing JSON is fallible by its type.
pub fn openapi_json() -> serde_json::Result<String> {
    let router = public_routes().merge(keyed_routes());
    let mut json = serde_json::to_string_pretty(router.get_openapi())?;
    json.push('\n');
    Ok(json)
}
