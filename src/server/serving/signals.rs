//! Signals that tell the process to stop.

use std::io;

use futures_util::{Stream, stream};

#[cfg(unix)]
use tokio::signal::unix::{Signal, SignalKind, signal};
#[cfg(windows)]
use tokio::signal::windows::{CtrlC, ctrl_c};

/// Ctrl-C and SIGTERM, caught from [`Signals::install`] on.
pub(super) struct Signals {
    #[cfg(unix)]
    interrupt: Signal,
    #[cfg(unix)]
    terminate: Signal,
    #[cfg(windows)]
    interrupt: CtrlC,
}

impl Signals {
    #[cfg(unix)]
    pub(super) fn install() -> io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    #[cfg(windows)]
    pub(super) fn install() -> io::Result<Self> {
        Ok(Self { interrupt: ctrl_c()? })
    }

    /// Gives one item for every signal.
    pub(super) fn stream(self) -> impl Stream<Item = ()> + Send {
        stream::unfold(self, |mut signals| async { signals.next().await.map(|()| ((), signals)) })
    }

    async fn next(&mut self) -> Option<()> {
        #[cfg(unix)]
        tokio::select! {
            told = self.interrupt.recv() => told,
            told = self.terminate.recv() => told,
        }
        #[cfg(windows)]
        self.interrupt.recv().await
    }
}
