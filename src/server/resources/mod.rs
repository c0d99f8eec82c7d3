//! Everything that is bounded and shared by requests.

mod admission;
mod budget;
mod transfers;
mod turns;
mod uploads;

use std::{sync::Arc, time::Duration};

pub(crate) use self::{
    admission::{Admission, Permit},
    budget::{Budget, Reservation, Short},
    turns::Stay,
    uploads::{HeldBytes, UploadReservation, Uploads},
};
use super::{
    config::{ByteSize, Limits, Role, Seconds},
    error::ServerError,
    layers::client::Client,
    metrics::{Metrics, SharedMetrics},
};

/// How long a response waits for its memory, where the request has time for twice that.
const WAIT_FOR_MEMORY: Duration = Duration::from_secs(10);

/// The budgets of one server.
#[derive(Debug)]
pub(crate) struct Resources {
    pub(crate) admission: Admission,
    pub(crate) uploads: Uploads,
    /// Seconds of audio that may be processed.
    pub(crate) audio: Budget,
    /// Bytes of responses that may wait for their readers.
    responses: Budget,
    /// Results of jobs that may be written, and characters that may be read, at the same time; and
    /// those that wait for it.
    pub(crate) writers: Admission,
    memory: ByteSize,
    /// Time after which a client that reads too little gives its memory back.
    idle_timeout: Seconds,
    wait_for_memory: Duration,
}

impl Resources {
    pub(crate) fn new(limits: &Limits, role: Role, metrics: &SharedMetrics) -> Self {
        let audio = limits.audio_seconds_in_flight as u64;
        let memory = limits.answer_memory.0;
        Self {
            // Every worker of a process that only works on jobs is for jobs.
            admission: Admission::new(limits, role != Role::Worker, Arc::clone(metrics)),
            uploads: Uploads::new(limits, metrics),
            audio: Budget::new(audio, metrics.audio_in_flight.clone()),
            responses: Budget::shared(
                memory,
                limits.share_of(memory),
                metrics.answer_bytes.clone(),
            ),
            // Metrics of their own, which nobody sees: these are not generations.
            writers: Admission::new(limits, true, Arc::new(Metrics::default())),
            memory: limits.answer_memory,
            idle_timeout: limits.answer_idle_timeout,
            // Within the time of the request: one that waits for longer is not told why.
            wait_for_memory: WAIT_FOR_MEMORY.min(limits.request_timeout.0 / 2),
        }
    }

    /// Reserves memory for a response, before anything of it is written. The wait is short: the
    /// request keeps its worker meanwhile.
    ///
    /// # Errors
    /// [`ServerError::UnreadAnswers`] at once for a client that leaves its share unread;
    /// [`ServerError::AnswerMemory`].
    pub(crate) async fn reserve_response(
        &self,
        client: Client,
        bytes: usize,
    ) -> Result<Reservation, ServerError> {
        let reserved = self.responses.reserve_for(client, bytes as u64);
        match tokio::time::timeout(self.wait_for_memory, reserved).await {
            Ok(Ok(reserved)) => Ok(reserved),
            Ok(Err(_)) => Err(self.unread()),
            Err(_) => Err(ServerError::AnswerMemory {
                memory: self.memory,
                retry_after: self.idle_timeout,
            }),
        }
    }

    /// Reserves memory for a small response that exists.
    ///
    /// # Errors
    /// As [`Resources::reserve_response`], at once.
    pub(crate) fn try_reserve_response(
        &self,
        client: Client,
        bytes: u64,
    ) -> Result<Reservation, ServerError> {
        let bytes = self.responses.clamp(bytes).into();
        self.responses.try_reserve_for(client, bytes).map_err(|short| match short {
            Short::Share => self.unread(),
            Short::All => {
                ServerError::AnswerMemory { memory: self.memory, retry_after: self.idle_timeout }
            }
        })
    }

    /// Refuses a client that leaves all of its share unread, before it costs more.
    ///
    /// # Errors
    /// [`ServerError::UnreadAnswers`].
    pub(crate) fn check_unread(&self, client: Client) -> Result<(), ServerError> {
        match self.responses.is_share_left(client) {
            true => Ok(()),
            false => Err(self.unread()),
        }
    }

    /// Refuses an answer on a rig that would take more than there is for all of them.
    ///
    /// # Errors
    /// [`ServerError::RigTooLong`].
    pub(crate) fn check_fits(&self, bytes: usize) -> Result<(), ServerError> {
        let (bytes, memory) = (ByteSize(bytes as u64), self.memory);
        match bytes > memory {
            true => Err(ServerError::RigTooLong { bytes, memory }),
            false => Ok(()),
        }
    }

    fn unread(&self) -> ServerError {
        ServerError::UnreadAnswers { memory: self.memory, retry_after: self.idle_timeout }
    }

    /// When a request that found no room in time would probably find some: the longest wait for
    /// any budget that is used up.
    pub(crate) fn retry_after(&self) -> Seconds {
        let audio = self.audio.is_exhausted().then(|| self.audio.retry_after(1));
        let responses = self.responses.is_exhausted().then_some(self.idle_timeout);
        [audio, responses].into_iter().flatten().fold(self.admission.retry_after(), Seconds::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_late_request_is_told_to_wait_for_what_is_used_up() {
        let limits = Limits {
            answer_memory: ByteSize(10),
            answer_idle_timeout: Seconds::new(7),
            request_timeout: Seconds(Duration::from_millis(40)),
            ..Limits::default()
        };
        let resources = Resources::new(&limits, Role::All, &SharedMetrics::default());
        assert_eq!(resources.retry_after(), Seconds::new(2));
        let held = resources.reserve_response(Client::Unknown, 1_000).await.unwrap();
        assert_eq!(resources.retry_after(), Seconds::new(7));
        assert!(matches!(
            resources.reserve_response(Client::Unknown, 1).await,
            Err(ServerError::AnswerMemory { retry_after, .. }) if retry_after == Seconds::new(7)
        ));
        drop(held);
        let song = resources.audio.reserve(u64::MAX).await;
        assert_eq!(resources.retry_after(), Seconds::new(2));
        drop(song);
    }
}
