//! What is stored of a dance that was made.

use std::sync::Arc;

use bailando_jobs::Lease;
use bytes::Bytes;

use crate::{
    formats::{GeneratedMotion, OutputFormat, to_stored},
    server::{
        blocking,
        error::ServerError,
        jobs::{
            order::{StoredResult, to_text},
            service::Jobs,
        },
        options::RequestOptions,
        state::SharedState,
    },
};

/// A result as the table has it, and the bytes of its files.
pub(super) struct Kept {
    pub(super) text: String,
    pub(super) bytes: i64,
}

/// Stores a dance: all of it, so that any format can be written later, and the file that was
/// ordered, which is then sent as it is.
pub(super) async fn store(
    state: &SharedState,
    lease: &Lease,
    dance: GeneratedMotion,
    options: RequestOptions,
    format: OutputFormat,
) -> Result<Kept, ServerError> {
    let dance = Arc::new(dance);
    let written = Arc::clone(&dance);
    let motion = blocking::write(&state.metrics, None, move || Ok(to_stored(&written)?)).await?;
    state.jobs.check_result(&lease.job, motion.len()).await?;
    let mut bytes = put(&state.jobs, lease, "motion", motion).await?;
    let mut file_bytes = None;
    // In memory the motion is enough, and smaller.
    if state.jobs.durable {
        let written = Arc::clone(&dance);
        let write = move || Ok(options.write(&written, format)?);
        let file = blocking::write(&state.metrics, None, write).await?;
        let all = usize::try_from(bytes).unwrap_or(usize::MAX).saturating_add(file.len());
        state.jobs.check_result(&lease.job, all).await?;
        let size = put(&state.jobs, lease, format.name(), file).await?;
        bytes += size;
        file_bytes = Some(size);
    }
    let result = StoredResult::new(&dance, lease.job.starts, file_bytes);
    Ok(Kept { text: to_text(&result)?, bytes: i64::try_from(bytes).unwrap_or(i64::MAX) })
}

async fn put(jobs: &Jobs, lease: &Lease, kind: &str, bytes: Vec<u8>) -> Result<u64, ServerError> {
    let name = Jobs::result(lease.job.id, lease.job.starts, kind);
    Ok(jobs.files.put(&name, Bytes::from(bytes)).await?)
}
