//! Whether the server takes requests, drains, or gives up on what is left.

use tokio_util::{
    sync::CancellationToken,
    task::{TaskTracker, task_tracker::TaskTrackerToken},
};

/// Counts the requests under way and tells them when the end has come.
#[derive(Debug, Default)]
pub(crate) struct Lifecycle {
    draining: CancellationToken,
    aborted: CancellationToken,
    requests: TaskTracker,
}

impl Lifecycle {
    /// Registers a request until the token is dropped; none while draining.
    pub(crate) fn enter(&self) -> Option<TaskTrackerToken> {
        // Registered first: a drain that starts in between waits for this request.
        let token = self.requests.token();
        (!self.is_draining()).then_some(token)
    }

    /// Registers what belongs to a request that was accepted before, also while draining.
    pub(crate) fn go_on(&self) -> TaskTrackerToken {
        self.requests.token()
    }

    pub(crate) fn is_draining(&self) -> bool {
        self.draining.is_cancelled()
    }

    /// From now on no request enters.
    pub(crate) fn drain(&self) {
        self.draining.cancel();
        self.requests.close();
    }

    /// Waits for [`Lifecycle::drain`].
    pub(crate) async fn draining(&self) {
        self.draining.cancelled().await;
    }

    /// Waits, once draining, until no request is under way.
    pub(crate) async fn idle(&self) {
        self.requests.wait().await;
    }

    /// Requests under way.
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
