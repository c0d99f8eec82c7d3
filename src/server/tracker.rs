//! One request's work: its phase, what it holds, and whether somebody waits for it.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::{Mutex, MutexGuard};

use super::{
    metrics::SharedMetrics,
    resources::{Permit, Reservation, UploadReservation},
};
use crate::engine::{Progress, Stage};

/// Part of the server that a request is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    Upload,
    Queue,
    Decode,
    Features,
    Inference,
    Motion,
    Write,
}

impl Phase {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Upload => "upload",
            Self::Queue => "queue",
            Self::Decode => "decode",
            Self::Features => "features",
            Self::Inference => "inference",
            Self::Motion => "motion",
            Self::Write => "write",
        }
    }
}

/// Follows one request through the server.
#[derive(Debug)]
pub(crate) struct RequestTracker {
    metrics: SharedMetrics,
    // Held only to read or change a few fields.
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    phase: Phase,
    /// Work has begun and not ended.
    working: bool,
    /// When its client left while it was worked on.
    left: Option<Instant>,
    codes: (usize, usize),
}

impl RequestTracker {
    pub(crate) fn new(metrics: SharedMetrics) -> Arc<Self> {
        Arc::new(Self {
            metrics,
            state: Mutex::new(State {
                phase: Phase::Upload,
                working: false,
                left: None,
                codes: (0, 0),
            }),
        })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    pub(crate) fn phase(&self) -> Phase {
        self.state().phase
    }

    /// Pairs of codes that exist, and that will.
    pub(crate) fn codes_done(&self) -> (usize, usize) {
        self.state().codes
    }

    pub(crate) fn enter(&self, phase: Phase) {
        self.state().phase = phase;
    }

    /// The work has ended.
    fn end(&self) {
        let mut state = self.state();
        state.working = false;
        let (phase, left) = (state.phase, state.left.take());
        drop(state);
        if let Some(left) = left {
            self.metrics.cancelled(phase.name(), left.elapsed());
        }
    }

    /// The client has left.
    fn leave(&self) {
        let mut state = self.state();
        let (phase, working) = (state.phase, state.working);
        if working {
            state.left = Some(Instant::now());
        }
        drop(state);
        if !working {
            self.metrics.cancelled(phase.name(), Duration::ZERO);
        }
    }
}

/// A client that waits: dropped before an answer, it counts the request as cancelled.
#[derive(Debug)]
pub(crate) struct Waiting {
    tracker: Arc<RequestTracker>,
    answered: bool,
}

impl Waiting {
    pub(crate) fn of(tracker: &Arc<RequestTracker>) -> Self {
        Self { tracker: Arc::clone(tracker), answered: false }
    }

    /// There is an answer, good or bad.
    pub(crate) fn answered(mut self) {
        self.answered = true;
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        if !self.answered {
            self.tracker.leave();
        }
    }
}

/// What the work on one request holds. The engine and all others who work on the request share it,
/// so that it is given back when the last of them has ended, whether or not a client still waits.
#[derive(Debug)]
pub(crate) struct Work {
    tracker: Arc<RequestTracker>,
    held: Mutex<Held>,
}

/// Shares of the server's resources.
#[derive(Debug)]
pub(crate) struct Held {
    /// Until the upload is decoded.
    pub(crate) upload: Option<UploadReservation>,
    /// Seconds of audio; those beyond the song's length are given back once that is known.
    pub(crate) audio: Option<Reservation>,
    pub(crate) permit: Option<Permit>,
}

impl Work {
    /// Work begins.
    pub(crate) fn begin(tracker: &Arc<RequestTracker>, held: Held) -> Arc<Self> {
        tracker.state().working = true;
        Arc::new(Self { tracker: Arc::clone(tracker), held: Mutex::new(held) })
    }

    pub(crate) fn tracker(&self) -> &RequestTracker {
        &self.tracker
    }

    /// Gives the audio back: the motion is made.
    pub(crate) fn free_audio(&self) {
        let mut held = self.held.lock();
        let freed = (held.upload.take(), held.audio.take());
        drop(held);
        drop(freed);
    }

    /// Gives back all but the permit, and ends the work.
    pub(crate) fn end(&self) -> Option<Permit> {
        self.free_audio();
        let permit = self.held.lock().permit.take();
        self.tracker.end();
        permit
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        drop(self.end());
    }
}

impl Progress for Work {
    fn stage(&self, stage: Stage) {
        self.tracker.enter(match stage {
            Stage::Decoding => Phase::Decode,
            Stage::Features => Phase::Features,
            Stage::Generating => Phase::Inference,
            Stage::Motion => Phase::Motion,
        });
    }

    fn decoded(&self, seconds: f64) {
        self.tracker.metrics.heard(seconds);
        let mut held = self.held.lock();
        let upload = held.upload.take();
        if let Some(audio) = &mut held.audio {
            audio.shrink_to(seconds.ceil() as u64);
        }
        drop(held);
        drop(upload);
    }

    fn codes(&self, done: usize, total: usize) {
        self.tracker.state().codes = (done, total);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::metrics::Metrics;

    fn counted(metrics: &Metrics, phase: &str) -> bool {
        let line = format!("bailando_cancelled_total{{phase=\"{phase}\"}} 1");
        metrics.text().unwrap().lines().any(|found| found == line)
    }

    fn begin(tracker: &Arc<RequestTracker>) -> Arc<Work> {
        let held = Held { upload: None, audio: None, permit: None };
        Work::begin(tracker, held)
    }

    #[test]
    fn a_client_that_leaves_before_the_work_begins_is_counted_at_once() {
        let metrics = SharedMetrics::new(Metrics::default());
        let tracker = RequestTracker::new(Arc::clone(&metrics));
        tracker.enter(Phase::Queue);
        drop(Waiting::of(&tracker));
        assert!(counted(&metrics, "queue"));
    }

    #[test]
    fn a_client_that_leaves_meanwhile_is_counted_when_the_last_who_works_has_ended() {
        let metrics = SharedMetrics::new(Metrics::default());
        let tracker = RequestTracker::new(Arc::clone(&metrics));
        let waiting = Waiting::of(&tracker);
        let work = begin(&tracker);
        let engine = Arc::clone(&work);
        work.stage(Stage::Features);
        drop((waiting, work));
        assert!(!counted(&metrics, "features"));
        drop(engine);
        assert!(counted(&metrics, "features"));
    }

    #[test]
    fn a_client_that_has_an_answer_is_not_counted() {
        let metrics = SharedMetrics::new(Metrics::default());
        let tracker = RequestTracker::new(Arc::clone(&metrics));
        let work = begin(&tracker);
        assert!(work.end().is_none());
        Waiting::of(&tracker).answered();
        drop(work);
        let text = metrics.text().unwrap();
        assert!(!text.contains("bailando_cancelled_total{"));
    }
}
