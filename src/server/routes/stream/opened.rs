//! A streamed dance that has begun, and what its work tells.

use std::time::Duration;

use ndarray::Array2;
use tokio::sync::mpsc;

use crate::{
    engine::{GenerationOutput, MotionStream, Opening},
    server::{error::ServerError, intake::Order, resources::Reservation},
};

/// A dance that has begun.
pub(super) struct Opened {
    pub(super) order: Order,
    pub(super) opening: Opening,
    pub(super) events: mpsc::UnboundedReceiver<Event>,
    pub(super) room: Reservation,
}

/// Messages of the work to the answer. All of a dance fits into the answer memory that is reserved
/// for it.
pub(super) enum Event {
    Opened(Box<Opening>),
    Frames(Array2<f32>),
    Ended(Box<Result<GenerationOutput, ServerError>>),
}

/// Passes on what the engine tells.
pub(super) struct Forward {
    /// Time spent waiting for a place to work in.
    pub(super) waited: Duration,
    pub(super) sender: mpsc::UnboundedSender<Event>,
}

impl MotionStream for Forward {
    fn opened(&self, mut opening: Opening) {
        opening.timings.queue += self.waited;
        // The client may have gone: the work is cancelled then.
        let _ = self.sender.send(Event::Opened(Box::new(opening)));
    }

    fn frames(&self, motion: Array2<f32>) {
        let _ = self.sender.send(Event::Frames(motion));
    }
}
