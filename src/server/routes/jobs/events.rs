//! `GET /jobs/{id}/events`: a job's progress as it is made.

use std::{sync::Arc, time::Duration};

use axum::{
    extract::{Extension, Path, State, rejection::PathRejection},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use bailando_jobs::JobRecord;
use bytes::Bytes;
use futures_util::{Stream, stream};
use tokio::time::{Instant, sleep};

use super::find::find;
use crate::server::{
    error::ServerError,
    jobs::{service::Reader, status::JobStatus},
    layers::{client::Client, envelope::Held},
    response::{documented::JobErrors, negotiate::EVENTS, paced},
    routes::stream::unbuffered,
    state::SharedState,
};

/// Time between two looks at a job.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
/// Streams of one client that look so often, its results that are read counted. Of more, each looks
/// less often, so that they ask the database no more often together.
const QUICK: usize = 32;
/// A comment is sent after so much silence, so that proxies keep the connection.
const LONGEST_SILENCE: Duration = Duration::from_secs(15);
/// The id of the last event. A browser's `EventSource` connects again after the end, and names it.
const LAST: &str = "end";

/// Follows a job to its end.
///
/// Server-sent events that a browser's `EventSource` can read: `progress` with a `JobStatus`
/// whenever it changes, then one `done` or `failed` with the last one. Asked again after that, with
/// the last event's id as `EventSource` does, the answer is 204, which ends it.
#[utoipa::path(
    get,
    path = "/jobs/{id}/events",
    operation_id = "follow_job",
    tag = "jobs",
    params(("id" = String, Path, description = "The job's id.")),
    responses(
        (
            status = 200,
            description = "Events `progress`, then `done` or `failed`; each carries a JobStatus.",
            body = String,
            content_type = "text/event-stream",
        ),
        (status = 204, description = "The last event was sent before."),
        JobErrors,
    )
)]
pub(crate) async fn events(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    id: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, ServerError> {
    let job = find(&state, client, id).await?;
    if headers.get("last-event-id").is_some_and(|id| id == LAST) {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let mut head = HeaderMap::new();
    head.insert(header::CONTENT_TYPE, HeaderValue::from_static(EVENTS));
    unbuffered(&mut head);
    let follower = Follower::new(Arc::clone(&state), state.jobs.read(client)?, job);
    let body = paced::from_stream(follower.events(), state.pace());
    Ok((Held::Paced, head, body).into_response())
}

/// Looks at a job, and tells what has changed.
struct Follower {
    state: SharedState,
    job: JobRecord,
    told: String,
    told_at: Instant,
    reader: Reader,
}

/// Time until the next look of each of so many streams of one client.
fn pause(streams: usize) -> Duration {
    LOOK_AGAIN * u32::try_from(streams.div_ceil(QUICK).max(1)).unwrap_or(u32::MAX)
}

impl Follower {
    fn new(state: SharedState, reader: Reader, job: JobRecord) -> Self {
        // Nothing of these is told, and there may be many followers.
        let job = JobRecord { order: String::new(), result: None, ..job };
        Self { state, job, told: String::new(), told_at: Instant::now(), reader }
    }

    fn events(self) -> impl Stream<Item = Bytes> + Send + 'static {
        stream::unfold(Some(self), |follower| async move {
            let mut follower = follower?;
            let (event, goes_on) = follower.next().await;
            Some((event, goes_on.then_some(follower)))
        })
    }

    /// The next event, and whether there are more.
    async fn next(&mut self) -> (Bytes, bool) {
        loop {
            self.state.jobs.ask(self.job.id);
            let found = self.state.jobs.look(self.job.id).await;
            let deleted = matches!(found, Ok(None));
            // While the table does not answer, what was known is told.
            if let Ok(Some(job)) = found {
                self.job = job;
            }
            let Ok(status) = JobStatus::of(&self.state.jobs, &self.job) else {
                return (format!("event: failed\nid: {LAST}\ndata: {{}}\n\n").into(), false);
            };
            let json = serde_json::to_string(&status).unwrap_or_default();
            if self.job.state.is_final() || deleted {
                let name = if status.state == "done" { "done" } else { "failed" };
                return (format!("event: {name}\nid: {LAST}\ndata: {json}\n\n").into(), false);
            }
            if json != self.told {
                let event = format!("event: progress\ndata: {json}\n\n");
                (self.told, self.told_at) = (json, Instant::now());
                return (event.into(), true);
            }
            if self.told_at.elapsed() > LONGEST_SILENCE {
                self.told_at = Instant::now();
                return (Bytes::from_static(b": still at it\n\n"), true);
            }
            sleep(pause(self.reader.of_client())).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_streams_of_a_client_look_no_more_often_than_a_few() {
        for (streams, times) in [(1, 1), (QUICK, 1), (QUICK + 1, 2), (100 * QUICK, 100)] {
            assert_eq!(pause(streams), LOOK_AGAIN * times, "{streams}");
        }
    }
}
