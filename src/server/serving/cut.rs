//! Tasks that write responses, and that can be ended from elsewhere: what a reader has not taken is
//! dropped with its task, wherever it lies. Over HTTP/1 that is the connection, over HTTP/2 a
//! stream, which is reset then.

use std::future::Future;

use hyper::rt::Executor;
use tokio_util::sync::CancellationToken;

tokio::task_local! {
    static WRITER: CancellationToken;
}

/// Ends the task that it was taken from.
#[derive(Clone, Debug)]
pub(crate) struct Cut(CancellationToken);

impl Cut {
    /// That of the current task, if it can be ended.
    pub(crate) fn of_this_task() -> Option<Self> {
        WRITER.try_with(|writer| Self(writer.clone())).ok()
    }

    pub(crate) fn cut(&self) {
        self.0.cancel();
    }
}

/// Does `work` until it ends or is cut.
pub(super) async fn until_cut(work: impl Future<Output = ()>) {
    let writer = CancellationToken::new();
    let cut = writer.clone();
    tokio::select! {
        () = WRITER.scope(writer, work) => {}
        () = cut.cancelled() => tracing::debug!("a reader was given up"),
    }
}

/// Runs each stream of an HTTP/2 connection as a task that can be cut.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamExecutor;

impl<F: Future<Output = ()> + Send + 'static> Executor<F> for StreamExecutor {
    fn execute(&self, stream: F) {
        tokio::spawn(until_cut(stream));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_task_ends_when_it_is_cut() {
        assert!(Cut::of_this_task().is_none());
        until_cut(async {
            let cut = Cut::of_this_task().unwrap();
            tokio::spawn(async move { cut.cut() });
            std::future::pending().await
        })
        .await;
    }
}
