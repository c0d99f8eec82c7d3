//! Durable jobs: a table of them in SQLite or PostgreSQL, and their files in a folder, in memory or
//! in an S3-compatible store. Knows neither HTTP nor what a job is about.
//!
//! A job is `queued` until a worker takes it on a lease. The worker renews the lease while it
//! works; when it dies, the lease ends and another takes the job. Every change that a worker makes
//! names its lease, so that one that was given up for dead changes nothing afterwards.
//!
//! ```
//! # tokio::runtime::Runtime::new()?.block_on(async {
//! use std::time::Duration;
//!
//! use bailando_jobs::{Claim, JobTable, NewJob, Reached, State};
//! use uuid::Uuid;
//!
//! let jobs = JobTable::in_memory();
//! let id = Uuid::new_v4();
//! jobs.insert(NewJob { id, ..NewJob::new("somebody", "{}") }).await?;
//! let model = "";
//! let (lease, full) = (Duration::from_secs(30), &[][..]);
//! let taken = jobs.claim(&Claim { model, lease, most_starts: 10, full }).await?;
//! let lease = taken.expect("the job was queued");
//! jobs.done(&lease, "{}".to_owned(), 0, &Reached::default()).await?;
//! let job = jobs.find(id).await?.expect("it is kept");
//! assert_eq!(job.state, State::Done);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! # })?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod callbacks;
mod claims;
mod database;
mod error;
mod files;
mod kind;
mod leases;
mod record;
mod room;
mod schema;
mod sweeps;
mod table;
#[cfg(test)]
mod tests;

pub use claims::Claim;
pub use error::JobsError;
pub use files::{FileWriter, Files};
pub use leases::{LONGEST_WAIT, Lease, PutBack, Reached};
pub use record::{JobRecord, Millis, NewJob, State, now};
pub use room::Kept;
pub use schema::SCHEMA;
pub use table::{Inserted, JobTable, Listing};
