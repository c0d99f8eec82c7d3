//! HTTP: routes, limits, errors, OpenAPI.
//!
//! The path of a request: `serving` (connection) → `layers` (id, trace, error shape, key, rate) →
//! `routes` → `intake` (checks that cost nothing, a place for the body, the body in `upload`) →
//! `resources` (a worker, a place in the queue, or 429) → `work` (waits for the engine) →
//! `response`. A job is stored instead (`jobs`), and one of the `workers` does the rest.

mod blocking;
mod callbacks;
mod config;
mod description;
mod error;
mod film;
mod info;
mod intake;
mod jobs;
mod layers;
mod metrics;
mod openapi;
pub(crate) mod options;
mod resources;
mod response;
mod rig;
mod router;
mod routes;
mod serving;
mod state;
mod telemetry;
mod tracker;
mod upload;
mod work;
mod workers;

pub use callbacks::{CallbackPolicy, CallbackSecret, SecretError};
pub use config::{
    Access, ApiKey, ByteSize, KeysError, Limits, LimitsError, Origin, Role, Seconds, ServerConfig,
    StorageConfig, StorageError, at_least_one,
};
pub use error::ErrorBody;
pub use film::{Film, serve_film};
pub use jobs::storage::JobStorage;
pub use metrics::Metrics;
pub use openapi::openapi_json;
pub use router::router;
pub use serving::{ServeError, Service, run, start};
pub use state::{Generate, JobSettings};
pub use telemetry::{Telemetry, TelemetryError, init_telemetry};
