//! Tells the callback URLs of jobs that they have ended.

use std::{collections::HashMap, time::Duration};

use bailando_jobs::{JobRecord, now};
use futures_util::{StreamExt, stream::FuturesUnordered};
use reqwest::{Client, header::CONTENT_TYPE};
use tokio::time::sleep;

use crate::server::{
    jobs::{owners::Owners, status::JobStatus},
    state::SharedState,
};

/// Time between two looks for ends to report.
const LOOK_AGAIN: Duration = Duration::from_secs(1);
/// Longer than a call takes: then another replica tries.
const LEASE: Duration = Duration::from_secs(30);
/// Waits between two tries, as Standard Webhooks recommends; after the last one it is given up.
const WAITS: [u64; 6] = [5, 60, 300, 1_800, 7_200, 18_000];
/// Calls at the same time, of which one owner has its share: a host that takes a call and never
/// answers keeps nobody else from being told.
const CALLS: usize = 16;

/// Reports until the process stops.
pub(super) async fn report(state: SharedState) {
    let client = match state.callbacks.client() {
        Ok(client) => client,
        Err(error) => {
            tracing::error!(%error, "no callback can be made");
            return;
        }
    };
    let stopping = state.lifecycle.stopping();
    let share = state.limits.share_of(CALLS as u64) as usize;
    let mut calls = FuturesUnordered::new();
    let mut busy: HashMap<String, usize> = HashMap::new();
    while !stopping.is_cancelled() {
        let full = busy.iter().filter(|(_, calls)| **calls >= share);
        let full: Vec<String> = full.map(|(owner, _)| owner.clone()).collect();
        let due = match calls.len() < CALLS {
            true => state.jobs.table.due_callback(LEASE, &full).await,
            false => Ok(None),
        };
        match due {
            Ok(Some(job)) => {
                if !Owners::is_unknown(&job.owner) {
                    *busy.entry(job.owner.clone()).or_default() += 1;
                }
                calls.push(told(&state, &client, job));
                continue;
            }
            Ok(None) => {}
            Err(error) => tracing::warn!(%error, "ends of jobs cannot be reported"),
        }
        tokio::select! {
            Some(owner) = calls.next() => {
                if let Some(own) = busy.get_mut(&owner) {
                    *own -= 1;
                }
                busy.retain(|_, own| *own > 0);
            }
            () = sleep(LOOK_AGAIN) => {}
            () = stopping.cancelled() => {}
        }
    }
    while calls.next().await.is_some() {}
}

/// Tells the end of a job; whose it is.
async fn told(state: &SharedState, client: &Client, job: JobRecord) -> String {
    tell(state, client, &job).await;
    job.owner
}

async fn tell(state: &SharedState, client: &Client, job: &JobRecord) {
    let told = call(state, client, job).await;
    let tries = usize::try_from(job.callback_tries).unwrap_or(usize::MAX);
    let again = match &told {
        Ok(()) => None,
        Err(_) => WAITS.get(tries.saturating_sub(1)).map(|wait| Duration::from_secs(*wait)),
    };
    let outcome = match (&told, again) {
        (Ok(()), _) => "taken",
        (Err(_), Some(_)) => "again",
        (Err(_), None) => "given_up",
    };
    state.metrics.callbacks.get_or_create(&[("outcome", outcome)]).inc();
    if let Err(problem) = told {
        tracing::warn!(id = %job.id, problem, outcome, "a callback was not taken");
    }
    if let Err(error) = state.jobs.table.reported(job.id, again).await {
        tracing::warn!(%error, "a callback may be made twice");
    }
}

async fn call(state: &SharedState, client: &Client, job: &JobRecord) -> Result<(), String> {
    let Some(url) = &job.callback_url else { return Ok(()) };
    // The list may have become shorter since.
    state.callbacks.check(url)?;
    let status = JobStatus::of(&state.jobs, job).map_err(|error| error.to_string())?;
    let kind = format!("job.{}", job.state.name());
    let body = serde_json::json!({ "type": kind, "data": status }).to_string();
    let (id, timestamp) = (format!("msg_{}", job.id), now() / 1000);
    let answer = client
        .post(url)
        .header(CONTENT_TYPE, "application/json")
        .header("webhook-signature", state.callbacks.sign(&id, timestamp, &body))
        .header("webhook-id", id)
        .header("webhook-timestamp", timestamp)
        .body(body)
        .send()
        .await
        .map_err(|error| format!("{:?}", error.without_url()))?;
    match answer.status().is_success() {
        true => Ok(()),
        false => Err(format!("it was answered {}", answer.status())),
    }
}
