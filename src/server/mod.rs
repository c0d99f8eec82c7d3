//! HTTP: routes, limits, errors, OpenAPI.
//!
//! A request's way: [`envelope`](self) (id, trace, error shape) → handler → checks that cost nothing
//! → admission (a permit, or a place in line, or 429) → body → engine on a blocking thread → answer.

mod admission;
mod body;
mod config;
mod envelope;
mod error;
mod info;
mod lifecycle;
mod logging;
mod media;
mod negotiate;
mod openapi;
mod options;
mod outgoing;
mod router;
mod routes;
mod serve;
mod state;
mod stop;
mod upload;
mod warnings;

pub use config::{ByteSize, Limits, LimitsError, Seconds, ServerConfig};
pub use error::ErrorBody;
pub use logging::init_logging;
pub use openapi::openapi_json;
pub use router::router;
pub use serve::{ServeError, run, start};
pub use state::Generate;
