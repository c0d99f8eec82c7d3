//! How far a job is, as callers see it.

use bailando_jobs::{JobRecord, Millis, State, now};
use serde::Serialize;
use utoipa::ToSchema;

use super::{
    order::{StoredError, from_text},
    service::Jobs,
};
use crate::server::error::{ErrorBody, Report, ServerError};

/// How far a job is.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct JobStatus {
    /// The job's id.
    #[schema(example = "67e55044-10b1-426f-9247-bb680e5fe0c8")]
    id: String,
    /// `queued`, `running`, `done` or `failed`.
    #[schema(example = "running")]
    pub(crate) state: &'static str,
    /// What is being done while it runs: `queue` for a worker, `decode`, `features`, `inference`,
    /// `motion` or `write`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    stage: Option<String>,
    /// Pairs of pose codes that exist.
    codes_done: u64,
    /// Pairs of pose codes of the whole dance; 0 while that is not known.
    codes_total: u64,
    /// A client's jobs of a higher priority begin first.
    priority: i64,
    /// How often it has begun.
    starts: u64,
    /// When it was ordered (RFC 3339).
    #[schema(example = "2026-11-29T12:00:00.000Z")]
    created_at: String,
    /// When it began, for the last time.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    started_at: Option<String>,
    /// When it was done, or had failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    finished_at: Option<String>,
    /// When it fails if it has not begun.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    expires_at: Option<String>,
    /// Seconds until it is done, while it runs and its pace is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    seconds_left: Option<f64>,
    /// Where the result is, once there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    result: Option<String>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    error: Option<ErrorBody>,
}

/// A page of jobs, the latest first.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct JobList {
    pub(crate) jobs: Vec<JobStatus>,
    /// The value of `before` that gives the next page; absent on the last one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub(crate) next: Option<String>,
}

impl JobStatus {
    /// # Errors
    /// [`ServerError::Internal`] for a record that this release cannot read.
    pub(crate) fn of(jobs: &Jobs, job: &JobRecord) -> Result<Self, ServerError> {
        let count = |codes: i64| u64::try_from(codes).unwrap_or(0);
        let (mut stage, mut codes) = (job.stage.clone(), (job.codes_done, job.codes_total));
        // What is done here is known to the moment.
        if let Some(running) = jobs.running(job.id).filter(|_| job.state == State::Running) {
            stage = Some(running.tracker.phase().name().to_owned());
            let (done, total) = running.tracker.codes_done();
            let count = |codes: usize| i64::try_from(codes).unwrap_or(i64::MAX);
            codes = (count(done), count(total));
        }
        let running = job.state == State::Running;
        Ok(Self {
            id: job.id.to_string(),
            state: job.state.name(),
            stage: stage.filter(|_| running),
            codes_done: count(codes.0),
            codes_total: count(codes.1),
            priority: job.priority,
            starts: count(job.starts),
            created_at: rfc3339(job.created_at),
            started_at: job.started_at.map(rfc3339),
            finished_at: job.finished_at.map(rfc3339),
            expires_at: job.expires_at.map(rfc3339),
            seconds_left: seconds_left(job, codes).filter(|_| running),
            result: (job.state == State::Done).then(|| format!("/jobs/{}/result", job.id)),
            error: match job.state {
                State::Failed => Some(report(job)?.body(&job.request_id)),
                _ => None,
            },
        })
    }
}

/// Why a job failed.
///
/// # Errors
/// [`ServerError::Internal`] for a record that this release cannot read.
pub(crate) fn report(job: &JobRecord) -> Result<Report, ServerError> {
    match &job.error {
        Some(text) => Ok(from_text::<StoredError>(job.id, text)?.report(&job.request_id)),
        // Its row could not be read when it was to begin.
        None => {
            let lost = ServerError::Internal(format!("the record of job {} is broken", job.id));
            Ok(lost.report().repeated(&job.request_id))
        }
    }
}

/// At the pace so far, which the time before the first code slows down.
fn seconds_left(job: &JobRecord, (done, total): (i64, i64)) -> Option<f64> {
    let worked = now().saturating_sub(job.started_at?);
    (done > 0 && total >= done && worked >= 0)
        .then(|| (worked as f64 / done as f64 * (total - done) as f64).round() / 1000.0)
}

/// A time as RFC 3339 writes it, in UTC with milliseconds.
fn rfc3339(time: Millis) -> String {
    let (days, rest) = (time.div_euclid(86_400_000), time.rem_euclid(86_400_000));
    let (seconds, millis) = (rest / 1000, rest % 1000);
    // Years begin in March, so that the leap day is their last; eras of 400 years are alike.
    let shifted = days + 719_468;
    let (era, day) = (shifted.div_euclid(146_097), shifted.rem_euclid(146_097));
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let date = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * era + i64::from(month <= 2);
    let (hour, minute, second) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{date:02}T{hour:02}:{minute:02}:{second:02}.{millis:03}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_as_clocks_show_them() {
        for (time, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400_001, "2000-02-29T00:00:00.001Z"),
            (1_709_251_199_999, "2024-02-29T23:59:59.999Z"),
            (1_709_251_200_000, "2024-03-01T00:00:00.000Z"),
            (1_795_953_600_000, "2026-11-29T12:00:00.000Z"),
            (4_107_542_399_000, "2100-02-28T23:59:59.000Z"),
        ] {
            assert_eq!(rfc3339(time), text);
        }
    }
}
