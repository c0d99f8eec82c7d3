//! Whether the server accepts requests, drains, or gives up on the remaining ones.

use tokio_util::{
    sync::CancellationToken,
    task::{TaskTracker, task_tracker::TaskTrackerToken},
};

/// Counts the requests in progress and tells them to stop.
#[derive(Debug, Default)]
pub(crate) struct Lifecycle {
    draining: CancellationToken,
    aborted: CancellationToken,
    requests: TaskTracker,
    jobs: TaskTracker,
    /// Tasks that end by themselves once the server drains.
    pub(crate) background: TaskTracker,
}

impl Lifecycle {
    /// Registers a request until the token is dropped; none while draining.
    pub(crate) fn enter(&self) -> Option<TaskTrackerToken> {
        // Registered first: a drain that starts in between waits for this request.
        let token = self.requests.token();
        (!self.is_draining()).then_some(token)
    }

    /// Registers work that belongs to a request of earlier, also while draining.
    pub(crate) fn go_on(&self) -> TaskTrackerToken {
        self.requests.token()
    }

    /// Registers work on a job that another process resumes if this one is too slow: it is waited
    /// for, but nothing is lost without it.
    pub(crate) fn go_on_with_job(&self) -> TaskTrackerToken {
        self.jobs.token()
    }

    pub(crate) fn is_draining(&self) -> bool {
        self.draining.is_cancelled()
    }

    /// Triggered by [`Lifecycle::drain`].
    pub(crate) fn stopping(&self) -> CancellationToken {
        self.draining.clone()
    }

    /// Lets no more requests enter.
    pub(crate) fn drain(&self) {
        self.draining.cancel();
        self.requests.close();
        self.jobs.close();
        self.background.close();
    }

    /// Waits for [`Lifecycle::drain`].
    pub(crate) async fn draining(&self) {
        self.draining.cancelled().await;
    }

    /// Waits, once draining, until no request and no job is in progress.
    pub(crate) async fn idle(&self) {
        self.requests.wait().await;
        self.jobs.wait().await;
    }

    /// Number of requests in progress.
    pub(crate) fn under_way(&self) -> usize {
        self.requests.len()
    }

    /// Tells all requests to give up.
    pub(crate) fn abort(&self) {
        self.aborted.cancel();
    }

    /// Waits for [`Lifecycle::abort`].
    pub(crate) async fn aborted(&self) {
        self.aborted.cancelled().await;
    }
}
