//! HTTP: routes, limits, errors, OpenAPI.
//!
//! A request's way: `connection` (heads and peers in time) → `envelope` (id, trace, count, error shape) →
//! `access` (key, rate) → handler → `intake` (checks that cost nothing, a place for the body, the body) →
//! `admission` (a permit, or a place in line, or 429) → `work` (the engine, then a blocking thread that writes) → answer.

mod access;
mod admission;
mod body;
mod config;
mod connection;
mod envelope;
mod error;
mod form;
mod info;
mod intake;
mod jobs;
mod lifecycle;
mod media;
mod metrics;
mod negotiate;
mod openapi;
pub(crate) mod options;
mod outgoing;
mod process;
mod room;
mod router;
mod routes;
mod serve;
mod state;
mod stop;
mod telemetry;
mod tracker;
mod upload;
mod uploads;
mod warnings;
mod work;

pub use access::Access;
pub use config::{ApiKey, ByteSize, KeysError, Limits, LimitsError, Origin, Seconds, ServerConfig};
pub use error::ErrorBody;
pub use metrics::Metrics;
pub use openapi::openapi_json;
pub use router::router;
pub use serve::{ServeError, Service, run, start};
pub use state::Generate;
pub use telemetry::{Telemetry, TelemetryError, init_telemetry};
