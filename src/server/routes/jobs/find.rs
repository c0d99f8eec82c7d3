//! The job that a path names, if it is the caller's.

use axum::extract::{Path, rejection::PathRejection};
use bailando_jobs::JobRecord;
use uuid::Uuid;

use crate::server::{
    error::ServerError, jobs::owners::Owners, layers::client::Client, options::shorten,
    state::SharedState,
};

/// A job of this client: one that was ordered with a key is found with that key only.
pub(super) async fn find(
    state: &SharedState,
    client: Client,
    id: Result<Path<String>, PathRejection>,
) -> Result<JobRecord, ServerError> {
    let Path(id) = id.map_err(|_| ServerError::NoJob { id: "of this name".to_owned() })?;
    let none = || ServerError::NoJob { id: shorten(&id) };
    let job = Uuid::try_parse(&id).map_err(|_| none())?;
    let job = state.jobs.find(job).await?.ok_or_else(none)?;
    let open = Owners::is_open(&job.owner);
    match open || job.owner == state.jobs.owners().name(client) {
        true => Ok(job),
        false => Err(none()),
    }
}
