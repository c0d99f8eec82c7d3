//! Jobs: dances that are asked for now and fetched later.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::{
    config::{Limits, Seconds},
    error::{Report, ServerError},
    layers::client::Client,
    metrics::{Counted, SharedMetrics},
    options::RequestOptions,
    response::answer::Answers,
    tracker::RequestTracker,
};
use crate::formats::{GeneratedMotion, OutputFormat};

/// Where jobs are kept: in memory for now.
pub(crate) trait JobStore: Send + Sync {
    /// Whether one more of `owner` may be kept.
    ///
    /// # Errors
    /// [`ServerError::TooManyJobs`].
    fn check_room(&self, owner: Client) -> Result<(), ServerError>;

    /// Keeps a job.
    ///
    /// # Errors
    /// [`ServerError::TooManyJobs`].
    fn put(&self, job: Arc<Job>) -> Result<(), ServerError>;

    /// Finds a job.
    fn get(&self, id: Uuid) -> Option<Arc<Job>>;

    /// Takes a job out; whether it was there.
    fn remove(&self, id: Uuid) -> bool;
}

/// One job.
pub(crate) struct Job {
    pub(crate) id: Uuid,
    /// Who asked for it: nobody else finds it.
    pub(crate) owner: Client,
    /// Id of the request that asked for it.
    pub(crate) request_id: String,
    /// Its phase and progress.
    pub(crate) tracker: Arc<RequestTracker>,
    /// Triggered when it is deleted: that stops its work.
    pub(crate) deleted: CancellationToken,
    /// Triggered when its result has been sent.
    pub(crate) fetched: CancellationToken,
    metrics: SharedMetrics,
    // Held only to look at or to change the state.
    state: Mutex<Kept>,
}

struct Kept {
    state: JobState,
    counted: Counted,
    asked_about: Instant,
    done_at: Option<Instant>,
}

/// What has become of a job.
#[derive(Clone)]
pub(crate) enum JobState {
    Queued,
    Running,
    /// The dance, and how it was asked for.
    Done(Arc<Finished>),
    Failed(Report),
}

/// A dance and how it is written where the fetching request says nothing else.
pub(crate) struct Finished {
    pub(crate) dance: Arc<GeneratedMotion>,
    pub(crate) answers: Answers,
    pub(crate) options: RequestOptions,
    pub(crate) format: OutputFormat,
}

impl JobState {
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done(_) => "done",
            Self::Failed(_) => "failed",
        }
    }
}

impl Job {
    pub(crate) fn new(
        owner: Client,
        request_id: String,
        tracker: Arc<RequestTracker>,
        metrics: SharedMetrics,
    ) -> Arc<Self> {
        Arc::new(Self {
            id: Uuid::new_v4(),
            owner,
            request_id,
            tracker,
            deleted: CancellationToken::new(),
            fetched: CancellationToken::new(),
            state: Mutex::new(Kept {
                state: JobState::Queued,
                counted: metrics.job("queued"),
                asked_about: Instant::now(),
                done_at: None,
            }),
            metrics,
        })
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What has become of it; somebody asks.
    pub(crate) fn ask(&self) -> JobState {
        let mut kept = self.kept();
        kept.asked_about = Instant::now();
        kept.state.clone()
    }

    pub(crate) fn turn(&self, state: JobState) {
        let counted = self.metrics.job(state.name());
        let mut kept = self.kept();
        if matches!(state, JobState::Done(_) | JobState::Failed(_)) {
            kept.done_at = Some(Instant::now());
        }
        kept.counted = counted;
        kept.state = state;
    }

    /// Since when it is done or has failed.
    pub(crate) fn done_for(&self) -> Option<Duration> {
        self.kept().done_at.map(|since| since.elapsed())
    }

    /// Whether somebody probably waits for its result still.
    pub(crate) fn is_awaited(&self, within: Duration) -> bool {
        let kept = self.kept();
        let last = kept.done_at.map_or(kept.asked_about, |done| done.max(kept.asked_about));
        !self.fetched.is_cancelled() && last.elapsed() < within
    }
}

/// Keeps jobs in memory.
pub(crate) struct MemoryStore {
    most: usize,
    /// Of which one owner has so many at most.
    share: usize,
    ttl: Seconds,
    // Held only to look up, to put or to take out.
    jobs: Mutex<HashMap<Uuid, Arc<Job>>>,
}

impl MemoryStore {
    /// Within `limits`; finished jobs make room after their time.
    pub(crate) fn new(limits: &Limits) -> Self {
        let most = limits.max_jobs.get();
        Self {
            most,
            share: limits.share_of(most as u64) as usize,
            ttl: limits.job_ttl,
            jobs: Mutex::new(HashMap::new()),
        }
    }

    fn jobs(&self) -> MutexGuard<'_, HashMap<Uuid, Arc<Job>>> {
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        jobs.retain(|_, job| job.done_for().is_none_or(|time| time < self.ttl.0));
        jobs
    }

    /// The job whose place one more of `owner` takes: none while there are free ones; else the one
    /// that was fetched, of the owner's own where those are too many.
    fn replaced(
        &self,
        jobs: &HashMap<Uuid, Arc<Job>>,
        owner: Client,
    ) -> Result<Option<Uuid>, ServerError> {
        let own = |job: &&Arc<Job>| job.owner == owner;
        let within = owner == Client::Unknown || jobs.values().filter(own).count() < self.share;
        if within && jobs.len() < self.most {
            return Ok(None);
        }
        let candidates = || jobs.values().filter(|job| within || own(job));
        // A job whose result was fetched is missed least.
        let fetched = candidates().filter(|job| job.fetched.is_cancelled());
        if let Some(oldest) = fetched.max_by_key(|job| job.done_for()) {
            return Ok(Some(oldest.id));
        }
        // The next place is free when the oldest result goes, unless a client deletes one before.
        let oldest = candidates().filter_map(|job| job.done_for()).max();
        let wait = oldest.map_or(Duration::from_secs(10), |age| self.ttl.0.saturating_sub(age));
        Err(ServerError::TooManyJobs { most: self.most, retry_after: Seconds(wait) })
    }
}

impl JobStore for MemoryStore {
    fn check_room(&self, owner: Client) -> Result<(), ServerError> {
        self.replaced(&self.jobs(), owner).map(drop)
    }

    fn put(&self, job: Arc<Job>) -> Result<(), ServerError> {
        let mut jobs = self.jobs();
        if let Some(replaced) = self.replaced(&jobs, job.owner)? {
            forget(jobs.remove(&replaced));
        }
        jobs.insert(job.id, job);
        Ok(())
    }

    fn get(&self, id: Uuid) -> Option<Arc<Job>> {
        self.jobs().get(&id).cloned()
    }

    fn remove(&self, id: Uuid) -> bool {
        forget(self.jobs().remove(&id))
    }
}

/// Stops what is still done or held for a job that was taken out; whether there was one.
fn forget(job: Option<Arc<Job>>) -> bool {
    job.is_some_and(|job| {
        job.deleted.cancel();
        true
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job() -> Arc<Job> {
        job_of(Client::Unknown)
    }

    fn job_of(owner: Client) -> Arc<Job> {
        let metrics = SharedMetrics::default();
        let tracker = RequestTracker::new(Arc::clone(&metrics));
        Job::new(owner, "id".into(), tracker, metrics)
    }

    fn store(most: usize, ttl: Duration) -> MemoryStore {
        let max_jobs = most.try_into().unwrap();
        let limits = Limits { max_jobs, job_ttl: Seconds(ttl), ..Limits::default() };
        MemoryStore::new(&limits)
    }

    #[test]
    fn one_owner_leaves_places_to_others() {
        let (one, other) = (Client::Key(0), Client::Key(1));
        let store = store(4, Duration::from_secs(60));
        let first = job_of(one);
        store.put(Arc::clone(&first)).unwrap();
        for _ in 0..2 {
            store.put(job_of(one)).unwrap();
        }
        assert!(store.check_room(one).is_err() && store.put(job_of(one)).is_err());
        store.put(job_of(other)).unwrap();
        // Room that a client makes for itself is no room for others.
        first.turn(failed());
        first.fetched.cancel();
        store.put(job_of(one)).unwrap();
        assert!(store.get(first.id).is_none());
        assert!(store.put(job_of(other)).is_err());
    }

    fn failed() -> JobState {
        JobState::Failed(ServerError::MissingAudio.report())
    }

    #[test]
    fn finished_jobs_make_room_after_their_time() {
        let store = store(1, Duration::from_millis(30));
        let first = job();
        store.put(Arc::clone(&first)).unwrap();
        std::thread::sleep(Duration::from_millis(40));
        assert!(store.get(first.id).is_some(), "it is not finished");
        assert!(matches!(store.put(job()), Err(ServerError::TooManyJobs { most: 1, .. })));
        first.turn(failed());
        assert!(store.check_room(Client::Unknown).is_err());
        std::thread::sleep(Duration::from_millis(40));
        assert!(store.get(first.id).is_none());
        store.put(job()).unwrap();
    }

    #[test]
    fn who_has_its_dance_makes_room() {
        let store = store(1, Duration::from_secs(60));
        let first = job();
        store.put(Arc::clone(&first)).unwrap();
        first.turn(failed());
        assert!(store.put(job()).is_err());
        first.fetched.cancel();
        store.check_room(Client::Unknown).unwrap();
        store.put(job()).unwrap();
        assert!(store.get(first.id).is_none());
        assert!(first.deleted.is_cancelled());
    }

    #[test]
    fn a_deleted_job_stops() {
        let store = store(2, Duration::from_secs(60));
        let job = job();
        store.put(Arc::clone(&job)).unwrap();
        assert!(store.remove(job.id));
        assert!(!store.remove(job.id));
        assert!(job.deleted.is_cancelled());
    }

    #[test]
    fn a_result_is_awaited_until_it_is_fetched_or_nobody_asks() {
        let job = job();
        job.turn(failed());
        assert!(job.is_awaited(Duration::from_secs(60)));
        assert!(!job.is_awaited(Duration::ZERO));
        job.fetched.cancel();
        assert!(!job.is_awaited(Duration::from_secs(60)));
    }
}
