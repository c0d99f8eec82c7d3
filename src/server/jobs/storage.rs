//! Where jobs, their songs and their results are kept.

use std::{fmt, sync::Arc};

use bailando_jobs::{Files, JobTable};

/// Where jobs and their files are kept.
#[derive(Clone)]
pub struct JobStorage {
    pub(crate) table: Arc<JobTable>,
    pub(crate) files: Files,
    /// Whether they outlive the process.
    pub(crate) durable: bool,
}

impl JobStorage {
    /// Jobs and files that outlive the process.
    #[must_use]
    pub fn durable(table: JobTable, files: Files) -> Self {
        Self { table: Arc::new(table), files, durable: true }
    }
}

impl Default for JobStorage {
    /// In memory.
    fn default() -> Self {
        let table = Arc::new(JobTable::in_memory());
        Self { table, files: Files::in_memory(), durable: false }
    }
}

impl fmt::Debug for JobStorage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("JobStorage").field("durable", &self.durable).finish_non_exhaustive()
    }
}
