//! The documentation: bytes that are there once, whoever reads them.

use std::sync::{Arc, Mutex, PoisonError};

use axum::{
    Router,
    extract::{Path, State},
    http::{HeaderMap, HeaderValue, header},
    response::{IntoResponse, Redirect, Response},
    routing::get,
};
use bytes::Bytes;
use utoipa::openapi::OpenApi;
use utoipa_swagger_ui::{Config, SwaggerFile, serve};

use crate::server::{error::ServerError, layers::envelope::Held, options::shorten};

const DOCUMENT: &str = "/api-doc/openapi.json";
/// The script that starts the pages, and ours in its place.
const START: &str = "swagger-initializer.js";
const OUR_START: &str = include_str!("docs.js");

/// The pages at `/docs`, and the document that they show.
pub(crate) fn routes(document: &OpenApi) -> Router {
    let config = Arc::new(Config::from(DOCUMENT));
    let json = serde_json::to_vec(document).map(Bytes::from).map_err(Arc::new);
    let pages = Arc::new(Pages { json, config, read: Mutex::default() });
    Router::new()
        .route(DOCUMENT, get(Pages::document))
        .route("/docs", get(|| async { Redirect::to("/docs/") }))
        .route("/docs/", get(Pages::index))
        .route("/docs/{*file}", get(Pages::page))
        .with_state(pages)
}

/// The document, and the files of the pages that were read so far.
struct Pages {
    json: Result<Bytes, Arc<serde_json::Error>>,
    config: Arc<Config<'static>>,
    // Held only to find or to put one; there are no more than there are files.
    read: Mutex<Vec<(String, HeaderMap, Bytes)>>,
}

impl Pages {
    async fn document(State(pages): State<Arc<Self>>) -> Result<Response, ServerError> {
        let json = pages.json.clone();
        let json = json.map_err(|error| ServerError::Internal(error.to_string()))?;
        Ok((Held::Shared, [(header::CONTENT_TYPE, "application/json")], json).into_response())
    }

    async fn index(State(pages): State<Arc<Self>>) -> Result<Response, ServerError> {
        pages.get("index.html")
    }

    async fn page(
        State(pages): State<Arc<Self>>,
        Path(file): Path<String>,
    ) -> Result<Response, ServerError> {
        pages.get(&file)
    }

    fn get(&self, name: &str) -> Result<Response, ServerError> {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, headers, bytes)) = read.iter().find(|(known, ..)| known == name) {
            return Ok((Held::Shared, headers.clone(), bytes.clone()).into_response());
        }
        let file = serve(name, Arc::clone(&self.config));
        let file = file.map_err(|error| ServerError::Internal(error.to_string()))?;
        let missing = || ServerError::NotFound { path: format!("/docs/{}", shorten(name)) };
        let SwaggerFile { bytes, content_type, gzpipped, .. } = file.ok_or_else(missing)?;
        if name == START {
            let kind = [(header::CONTENT_TYPE, content_type)];
            return Ok((Held::Shared, kind, OUR_START).into_response());
        }
        let mut headers = HeaderMap::new();
        if let Ok(kind) = HeaderValue::try_from(content_type) {
            headers.insert(header::CONTENT_TYPE, kind);
        }
        if gzpipped {
            headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        let bytes = Bytes::from(bytes.into_owned());
        read.push((name.to_owned(), headers.clone(), bytes.clone()));
        Ok((Held::Shared, headers, bytes).into_response())
    }
}
