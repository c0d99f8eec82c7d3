//! Room for jobs: how many are kept, how many bytes they take, and which ones make room for more.

use std::time::Duration;

use bailando_jobs::{Inserted, JobRecord, NewJob, now};
use uuid::Uuid;

use super::{owners::Owners, service::Jobs};
use crate::server::{config::Seconds, error::ServerError, layers::client::Client};

/// Jobs that make room for one more, at most.
const MOST_REPLACED: usize = 16;
/// When to ask again while more than these have to.
const NEXT_ONES: Seconds = Seconds::new(1);

/// Why one more job cannot be kept.
struct Shortage<'a> {
    /// The owner that has its share, where that is why.
    of: Option<&'a str>,
    /// Whether bytes are short, not places.
    bytes: bool,
}

impl Jobs {
    /// Whether one more of `client` may be kept.
    ///
    /// # Errors
    /// [`ServerError::TooManyJobs`], [`ServerError::JobBytes`], [`ServerError::JobStore`].
    pub(crate) async fn check_room(&self, client: Client) -> Result<(), ServerError> {
        let owner = self.owners().name(client);
        match self.shortage(&owner).await? {
            Some(shortage) => self.replaceable(&shortage).await.map(drop),
            None => Ok(()),
        }
    }

    /// Whether there is room for a result of so many bytes, which the order may not have foreseen.
    ///
    /// # Errors
    /// [`ServerError::JobBytes`], [`ServerError::JobStore`].
    pub(crate) async fn check_result(
        &self,
        job: &JobRecord,
        bytes: usize,
    ) -> Result<(), ServerError> {
        let foreseen = u64::try_from(job.result_bytes).unwrap_or(0);
        let more = (bytes as u64).saturating_sub(foreseen);
        if more == 0 {
            return Ok(());
        }
        let kept = self.table.kept(&job.owner).await?;
        match u64::try_from(kept.bytes).unwrap_or(0).saturating_add(more) > self.limits.bytes.0 {
            true => Err(self.refused(&Shortage { of: None, bytes: true }, NEXT_ONES)),
            false => Ok(()),
        }
    }

    /// Makes room for a job and keeps it. Orders take turns, so that no two of this process take
    /// the same room.
    ///
    /// # Errors
    /// As [`Jobs::check_room`].
    pub(crate) async fn keep(&self, job: NewJob) -> Result<Inserted, ServerError> {
        let mut replaced = Vec::new();
        let turn = self.ordering.lock().await;
        let kept = match self.make_room(&job.owner, &mut replaced).await {
            Ok(()) => self.table.insert(job).await.map_err(ServerError::from),
            Err(error) => Err(error),
        };
        drop(turn);
        // The store may be slow, which is no reason for others to wait.
        for id in replaced {
            self.delete_files(id).await;
        }
        kept
    }

    /// Forgets `replaced`, whose files are then to be deleted.
    async fn make_room(&self, owner: &str, replaced: &mut Vec<Uuid>) -> Result<(), ServerError> {
        while let Some(shortage) = self.shortage(owner).await? {
            if replaced.len() == MOST_REPLACED {
                return Err(self.refused(&shortage, NEXT_ONES));
            }
            let id = self.replaceable(&shortage).await?;
            self.forget_row(id).await?;
            replaced.push(id);
        }
        Ok(())
    }

    /// Why one more of `owner` cannot be kept, if it cannot. A job is kept while there are fewer
    /// bytes than there may be: it may be the one that has more than are left.
    async fn shortage<'a>(&self, owner: &'a str) -> Result<Option<Shortage<'a>>, ServerError> {
        self.note_fetched().await?;
        let kept = self.table.kept(owner).await?;
        let limits = &self.limits;
        let count = |jobs: i64| usize::try_from(jobs).unwrap_or(0);
        let bytes = |bytes: i64| u64::try_from(bytes).unwrap_or(0);
        let own_fits = bytes(kept.own_bytes) < limits.share_of_bytes;
        let within = Owners::is_unknown(owner) || (count(kept.own) < limits.share && own_fits);
        let fits = bytes(kept.bytes) < limits.bytes.0 && (within || own_fits);
        let free = within && fits && count(kept.jobs) < limits.most;
        Ok((!free).then(|| Shortage { of: (!within).then_some(owner), bytes: !fits }))
    }

    /// The job whose place one more takes: one whose time is over, else the one that was fetched
    /// longest ago; of the owner that has its share, where that is why.
    async fn replaceable(&self, shortage: &Shortage<'_>) -> Result<Uuid, ServerError> {
        let of = shortage.of;
        let over = self.table.one_finished_before(self.finished_since(), of).await?;
        let replaceable = match over {
            Some(over) => Some(over),
            None => self.table.oldest_fetched(of).await?,
        };
        if let Some(replaceable) = replaceable {
            return Ok(replaceable);
        }
        // The next place is free when the oldest result goes, unless a client deletes one before.
        let oldest = self.table.oldest_finished(of).await?;
        let retry_after = oldest.map_or(Seconds::new(10), |finished| {
            let age = u64::try_from(now().saturating_sub(finished)).unwrap_or(0);
            Seconds(self.limits.ttl.saturating_sub(Duration::from_millis(age)))
        });
        Err(self.refused(shortage, retry_after))
    }

    fn refused(&self, shortage: &Shortage<'_>, retry_after: Seconds) -> ServerError {
        match shortage.bytes {
            true => ServerError::JobBytes { bytes: self.limits.bytes, retry_after },
            false => ServerError::TooManyJobs { most: self.limits.most, retry_after },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use futures_util::future::join_all;

    use super::*;
    use crate::server::{
        config::{ByteSize, Limits},
        jobs::storage::JobStorage,
    };

    fn jobs(limits: &Limits) -> Jobs {
        Jobs::new(JobStorage::default(), limits)
    }

    fn at_most(jobs: usize) -> Limits {
        let max_jobs = NonZeroUsize::new(jobs).unwrap();
        Limits { max_jobs, client_share: 1.0, ..Limits::default() }
    }

    async fn keep(jobs: &Jobs, job: NewJob) -> Result<(), ServerError> {
        assert_eq!(jobs.keep(job).await?, Inserted::New);
        Ok(())
    }

    #[tokio::test]
    async fn orders_at_the_same_time_take_no_more_room_than_there_is() {
        let job = || NewJob { expected_bytes: 100, ..NewJob::new("me", "{}") };
        let bytes = Limits { job_bytes: ByteSize(250), client_share: 1.0, ..Limits::default() };
        // The third is the one that has more than are left.
        for limits in [at_most(3), bytes] {
            let jobs = jobs(&limits);
            let kept = join_all((0..20).map(|_| keep(&jobs, job()))).await;
            assert_eq!(kept.iter().filter(|kept| kept.is_ok()).count(), 3);
        }
    }

    #[tokio::test]
    async fn a_result_that_nobody_foresaw_is_kept_where_there_is_room() {
        let jobs = jobs(&Limits { job_bytes: ByteSize(250), ..Limits::default() });
        let id = uuid::Uuid::new_v4();
        keep(&jobs, NewJob { id, expected_bytes: 100, ..NewJob::new("me", "{}") }).await.unwrap();
        let job = jobs.table.find(id).await.unwrap().unwrap();
        for fits in [0, 100, 240] {
            jobs.check_result(&job, fits).await.unwrap();
        }
        let refused = jobs.check_result(&job, 260).await;
        assert!(matches!(refused, Err(ServerError::JobBytes { .. })));
    }

    /// All the others are left to the sweeper.
    #[tokio::test]
    async fn an_order_clears_away_no_more_than_it_needs() {
        let jobs = jobs(&Limits { job_ttl: Seconds(Duration::from_millis(50)), ..at_most(3) });
        for _ in 0..2 {
            let done = Some(("{}".to_owned(), 0));
            keep(&jobs, NewJob { result: done, ..NewJob::new("me", "{}") }).await.unwrap();
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        for _ in 0..3 {
            keep(&jobs, NewJob::new("me", "{}")).await.unwrap();
            assert_eq!(jobs.table.kept("me").await.unwrap().jobs, 3);
        }
        let full = keep(&jobs, NewJob::new("me", "{}")).await;
        assert!(matches!(full, Err(ServerError::TooManyJobs { most: 3, .. })));
    }
}
