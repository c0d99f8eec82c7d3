//! One request's work: which phase it is in, what it holds, and who has left.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use super::{
    metrics::SharedMetrics,
    resources::{Reservation, UploadReservation},
};
use crate::{
    CancelToken,
    engine::{Progress, Stage},
};

/// Where a request is.
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

/// One request's work, shared by those who wait for it and those who do it.
#[derive(Debug)]
pub(crate) struct Watch {
    metrics: SharedMetrics,
    /// Tells the work to stop.
    pub(crate) cancel: CancelToken,
    // Held only to read or change a few fields.
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    phase: Phase,
    /// Work is being done: it tells itself when it ends.
    working: bool,
    left: Option<Instant>,
    codes: (usize, usize),
    upload: Option<UploadReservation>,
    audio: Option<Reservation>,
}

impl Watch {
    pub(crate) fn new(metrics: SharedMetrics) -> Arc<Self> {
        Arc::new(Self {
            metrics,
            cancel: CancelToken::new(),
            state: Mutex::new(State {
                phase: Phase::Upload,
                working: false,
                left: None,
                codes: (0, 0),
                upload: None,
                audio: None,
            }),
        })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
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

    /// Holds the upload until it is decoded.
    pub(crate) fn hold_upload(&self, upload: UploadReservation) {
        self.state().upload = Some(upload);
    }

    /// Holds the share of audio until the watch is gone; what is too much goes once the length is known.
    pub(crate) fn hold_audio(&self, audio: Reservation) {
        self.state().audio = Some(audio);
    }

    /// Work begins, unless nobody wants it any more.
    pub(crate) fn begin(&self) -> bool {
        let mut state = self.state();
        state.working = !self.cancel.is_cancelled();
        state.working
    }

    /// Work has ended, whichever way: nothing is held for it any more.
    pub(crate) fn end(&self) {
        let mut state = self.state();
        state.working = false;
        let (phase, left) = (state.phase, state.left.take());
        let held = (state.upload.take(), state.audio.take());
        drop(state);
        drop(held);
        if let Some(left) = left {
            self.metrics.cancelled(phase.name(), left.elapsed());
        }
    }

    /// Nobody waits any more.
    fn leave(&self) {
        let mut state = self.state();
        let (phase, working) = (state.phase, state.working);
        if working {
            state.left = Some(Instant::now());
        }
        drop(state);
        self.cancel.cancel();
        if !working {
            self.metrics.cancelled(phase.name(), Duration::ZERO);
        }
    }
}

impl Progress for Watch {
    fn stage(&self, stage: Stage) {
        self.enter(match stage {
            Stage::Decoding => Phase::Decode,
            Stage::Features => Phase::Features,
            Stage::Generating => Phase::Inference,
            Stage::Motion => Phase::Motion,
        });
    }

    fn decoded(&self, seconds: f64) {
        self.metrics.heard(seconds);
        let mut state = self.state();
        let upload = state.upload.take();
        if let Some(audio) = &mut state.audio {
            audio.shrink_to(seconds.ceil() as u64);
        }
        drop(state);
        drop(upload);
    }

    fn codes(&self, done: usize, total: usize) {
        self.state().codes = (done, total);
    }
}

/// Somebody who waits for work: dropped before an answer, it stops the work.
#[derive(Debug)]
pub(crate) struct Presence {
    watch: Arc<Watch>,
    answered: bool,
}

impl Presence {
    pub(crate) fn of(watch: &Arc<Watch>) -> Self {
        Self {
            watch: Arc::clone(watch),
            answered: false,
        }
    }

    /// There is an answer, good or bad.
    pub(crate) fn answered(mut self) {
        self.answered = true;
    }
}

impl Drop for Presence {
    fn drop(&mut self) {
        if !self.answered {
            self.watch.leave();
        }
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

    #[test]
    fn who_leaves_before_the_work_begins_is_counted_at_once() {
        let metrics = SharedMetrics::new(Metrics::default());
        let watch = Watch::new(Arc::clone(&metrics));
        watch.enter(Phase::Queue);
        drop(Presence::of(&watch));
        assert!(watch.cancel.is_cancelled());
        assert!(counted(&metrics, "queue"));
    }

    #[test]
    fn who_leaves_meanwhile_is_counted_when_the_work_has_ended() {
        let metrics = SharedMetrics::new(Metrics::default());
        let watch = Watch::new(Arc::clone(&metrics));
        let presence = Presence::of(&watch);
        assert!(watch.begin());
        watch.stage(Stage::Features);
        drop(presence);
        assert!(watch.cancel.is_cancelled());
        assert!(!counted(&metrics, "features"));
        watch.end();
        assert!(counted(&metrics, "features"));
    }

    #[test]
    fn who_has_an_answer_is_not_counted() {
        let metrics = SharedMetrics::new(Metrics::default());
        let watch = Watch::new(Arc::clone(&metrics));
        Presence::of(&watch).answered();
        assert!(!watch.cancel.is_cancelled());
        assert!(
            !metrics
                .text()
                .unwrap()
                .contains("bailando_cancelled_total{")
        );
    }
}
