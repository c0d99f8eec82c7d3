//! All jobs: kept in the table, with their files, within limits.

use std::{
    collections::{HashMap, hash_map::Entry},
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError},
    time::Duration,
};

use bailando_jobs::{Files, JobRecord, JobTable, JobsError, Millis, now};
use tokio::{sync::Notify, time::Instant};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::{owners::Owners, storage::JobStorage};
use crate::server::{
    config::{ByteSize, Limits, Seconds},
    error::ServerError,
    layers::client::Client,
    response::answer::Answers,
    tracker::RequestTracker,
};

/// Most bytes of songs and results where they are kept in memory.
const MEMORY: ByteSize = ByteSize(400_000_000);
/// Longest time that results are kept in memory.
const MEMORY_TTL: Seconds = Seconds::new(600);
/// When to ask again while the database or the store is down.
const STORE_RETRY: Seconds = Seconds::new(5);

/// The jobs of a service, as one replica sees them.
pub(crate) struct Jobs {
    pub(crate) table: Arc<JobTable>,
    pub(crate) files: Files,
    pub(crate) durable: bool,
    /// Rung when there may be something to do.
    pub(crate) wake: Notify,
    /// Held while a worker counts the running jobs of each owner and takes the next job.
    pub(crate) taking: tokio::sync::Mutex<()>,
    /// Held while room is made for an order, and it is kept.
    pub(super) ordering: tokio::sync::Mutex<()>,
    pub(crate) owners: OnceLock<Owners>,
    pub(super) limits: RoomLimits,
    /// Results and streams of events that are read at the same time: each holds about what a
    /// connection does, and a descriptor.
    most_readers: usize,
    share_of_readers: usize,
    /// Time in which a reader that takes nothing is given up.
    patience: Seconds,
    // Held only to look up, to put or to take out.
    here: Mutex<Here>,
}

/// How much may be kept, for how long.
pub(super) struct RoomLimits {
    pub(super) most: usize,
    pub(super) share: usize,
    pub(super) bytes: ByteSize,
    pub(super) share_of_bytes: u64,
    pub(super) ttl: Duration,
}

/// What this replica itself does for jobs.
#[derive(Default)]
struct Here {
    running: HashMap<Uuid, Running>,
    /// Results that are being written or read in formats that are not stored.
    answers: HashMap<Uuid, Arc<Answers>>,
    /// Results that were sent, and are not noted in the table yet.
    fetched: Vec<Uuid>,
    /// When somebody asked about a job last, where it ends with the process.
    asked: HashMap<Uuid, Instant>,
    /// How many results and streams of events each client reads.
    readers: HashMap<Client, usize>,
}

/// A job that is worked on here.
#[derive(Clone)]
pub(crate) struct Running {
    pub(crate) owner: String,
    pub(crate) tracker: Arc<RequestTracker>,
    /// Triggered when it is deleted: that stops its work.
    pub(crate) deleted: CancellationToken,
}

impl Jobs {
    pub(crate) fn new(storage: JobStorage, limits: &Limits) -> Self {
        let JobStorage { table, files, durable } = storage;
        let most = limits.max_jobs.get();
        let bytes = if durable { limits.job_bytes } else { limits.job_bytes.min(MEMORY) };
        let ttl = if durable { limits.job_ttl } else { limits.job_ttl.min(MEMORY_TTL) };
        Self {
            table,
            files,
            durable,
            wake: Notify::new(),
            taking: tokio::sync::Mutex::default(),
            ordering: tokio::sync::Mutex::default(),
            owners: OnceLock::new(),
            limits: RoomLimits {
                most,
                share: limits.share_of(most as u64) as usize,
                bytes,
                share_of_bytes: limits.share_of(bytes.0),
                ttl: ttl.0,
            },
            most_readers: limits.max_connections.get(),
            share_of_readers: limits.share_of(limits.max_connections.get() as u64) as usize,
            patience: limits.answer_idle_timeout,
            here: Mutex::default(),
        }
    }

    fn here(&self) -> MutexGuard<'_, Here> {
        self.here.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn owners(&self) -> &Owners {
        self.owners.get_or_init(Owners::default)
    }

    /// The folder of a job's files in the store.
    pub(crate) fn folder(id: Uuid) -> String {
        format!("jobs/{id}")
    }

    /// Its song.
    pub(crate) fn song(id: Uuid) -> String {
        format!("jobs/{id}/song")
    }

    /// Its result of one start: `motion`, or a format.
    pub(crate) fn result(id: Uuid, start: i64, kind: &str) -> String {
        format!("jobs/{id}/{start}.{kind}")
    }

    /// Results that were finished before this are gone.
    pub(crate) fn finished_since(&self) -> Millis {
        now().saturating_sub(i64::try_from(self.limits.ttl.as_millis()).unwrap_or(i64::MAX))
    }

    /// Finds a job.
    ///
    /// # Errors
    /// [`ServerError::JobStore`].
    pub(crate) async fn find(&self, id: Uuid) -> Result<Option<JobRecord>, ServerError> {
        Ok(self.unexpired(self.table.find(id).await?))
    }

    /// Finds how far a job is, without the texts of order and result.
    ///
    /// # Errors
    /// [`ServerError::JobStore`].
    pub(crate) async fn look(&self, id: Uuid) -> Result<Option<JobRecord>, ServerError> {
        Ok(self.unexpired(self.table.look(id).await?))
    }

    fn unexpired(&self, job: Option<JobRecord>) -> Option<JobRecord> {
        let since = self.finished_since();
        job.filter(|job| job.finished_at.is_none_or(|finished| finished >= since))
    }

    /// Stops a job, deletes its files and forgets it; whether there was one.
    ///
    /// # Errors
    /// [`ServerError::JobStore`] if it is still there.
    pub(crate) async fn forget(&self, id: Uuid) -> Result<bool, ServerError> {
        // The row first: a job without files would be a promise that is not kept.
        let known = self.forget_row(id).await?;
        self.delete_files(id).await;
        Ok(known)
    }

    /// Stops a job and forgets it, but for its files; whether there was one.
    pub(super) async fn forget_row(&self, id: Uuid) -> Result<bool, ServerError> {
        let known = self.table.delete(id).await?;
        let (running, _) = {
            let mut here = self.here();
            here.asked.remove(&id);
            (here.running.get(&id).cloned(), here.answers.remove(&id))
        };
        running.into_iter().for_each(|running| running.deleted.cancel());
        Ok(known)
    }

    /// Deletes the files of a job that was forgotten.
    pub(super) async fn delete_files(&self, id: Uuid) {
        if let Err(error) = self.files.delete_below(&Self::folder(id)).await {
            tracing::warn!(%id, %error, "files of a deleted job are left for the clean-up");
        }
    }

    /// Forgets the jobs whose time is over.
    ///
    /// # Errors
    /// [`ServerError::JobStore`].
    pub(crate) async fn expire(&self) -> Result<(), ServerError> {
        for id in self.table.finished_before(self.finished_since()).await? {
            self.forget(id).await?;
        }
        Ok(())
    }

    /// The result of a job was sent: its job makes room first.
    pub(crate) fn fetched(self: &Arc<Self>, id: Uuid) {
        self.here().fetched.push(id);
        let jobs = Arc::clone(self);
        tokio::spawn(async move {
            if let Err(error) = jobs.note_fetched().await {
                tracing::warn!(%error, "a result was sent and does not count as fetched");
            }
        });
    }

    pub(super) async fn note_fetched(&self) -> Result<(), JobsError> {
        let sent = std::mem::take(&mut self.here().fetched);
        for id in sent {
            self.table.fetched(id).await?;
        }
        Ok(())
    }

    /// Somebody asks about a job.
    pub(crate) fn ask(&self, id: Uuid) {
        if !self.durable {
            self.here().asked.insert(id, Instant::now());
        }
    }

    /// When somebody asked about a job last.
    pub(crate) fn asked(&self, id: Uuid) -> Option<Instant> {
        self.here().asked.get(&id).copied()
    }

    /// A job is worked on here, until the guard is dropped.
    pub(crate) fn begin(self: &Arc<Self>, id: Uuid, running: Running) -> BeingDone {
        let tracker = Arc::clone(&running.tracker);
        self.here().running.insert(id, running);
        BeingDone { jobs: Arc::clone(self), id, tracker }
    }

    /// The work on a job, if it is done here.
    pub(crate) fn running(&self, id: Uuid) -> Option<Running> {
        self.here().running.get(&id).cloned()
    }

    /// Owners that have `share` jobs in work here, or more.
    pub(crate) fn full_owners(&self, share: usize) -> Vec<String> {
        let mut counts: HashMap<String, usize> = HashMap::new();
        for running in self.here().running.values() {
            if !Owners::is_unknown(&running.owner) {
                *counts.entry(running.owner.clone()).or_default() += 1;
            }
        }
        counts.into_iter().filter(|(_, count)| *count >= share).map(|(owner, _)| owner).collect()
    }

    /// A client reads one more result or stream of events, until the guard is dropped.
    ///
    /// # Errors
    /// [`ServerError::Spare`] where it reads its share of them, or there are too many in all.
    pub(crate) fn read(self: &Arc<Self>, client: Client) -> Result<Reader, ServerError> {
        let mut here = self.here();
        let own = here.readers.get(&client).copied().unwrap_or(0);
        let within = client == Client::Unknown || own < self.share_of_readers;
        if !within || here.readers.values().sum::<usize>() >= self.most_readers {
            return Err(ServerError::Spare { retry_after: self.patience });
        }
        here.readers.insert(client, own + 1);
        drop(here);
        Ok(Reader { jobs: Arc::clone(self), client })
    }

    /// What is written of a job's result, shared by its readers.
    pub(crate) fn answers(&self, id: Uuid) -> Arc<Answers> {
        let mut here = self.here();
        // One that no reader holds has nothing that is worth to be kept.
        here.answers.retain(|_, answers| Arc::strong_count(answers) > 1 || answers.is_read());
        Arc::clone(here.answers.entry(id).or_default())
    }
}

/// A job is worked on here, as long as this lives.
pub(crate) struct BeingDone {
    jobs: Arc<Jobs>,
    id: Uuid,
    tracker: Arc<RequestTracker>,
}

impl Drop for BeingDone {
    fn drop(&mut self) {
        let mut here = self.jobs.here();
        // Where the clock was set forward, another worker here may have begun it again.
        if let Entry::Occupied(running) = here.running.entry(self.id)
            && Arc::ptr_eq(&running.get().tracker, &self.tracker)
        {
            running.remove();
        }
    }
}

/// A client reads a result or a stream of events, as long as this lives.
pub(crate) struct Reader {
    jobs: Arc<Jobs>,
    client: Client,
}

impl Reader {
    /// How many the client reads.
    pub(crate) fn of_client(&self) -> usize {
        self.jobs.here().readers.get(&self.client).copied().unwrap_or(1)
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        let mut here = self.jobs.here();
        if let Some(count) = here.readers.get_mut(&self.client) {
            *count -= 1;
            if *count == 0 {
                here.readers.remove(&self.client);
            }
        }
    }
}

impl From<JobsError> for ServerError {
    fn from(error: JobsError) -> Self {
        if matches!(error, JobsError::NoFile { .. }) {
            tracing::error!(%error, "a file of a job is gone");
            return Self::FilesGone;
        }
        if error.is_lasting() {
            return Self::Internal(error.to_string());
        }
        tracing::error!(%error, "jobs cannot be kept or found");
        Self::JobStore { retry_after: STORE_RETRY }
    }
}
