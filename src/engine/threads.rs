//! The threads that prepare requests and that schedule them.

use std::{num::NonZeroUsize, sync::Arc, thread};

use super::{
    EngineError,
    observer::guarded,
    prepare::{AudioRequest, Preparer},
    queue::{Entry, Queue},
    scheduler::{ScheduledRequest, Scheduler},
};

/// Most threads that prepare songs side by side for the cores' sake.
const MOST_FRONTENDS: usize = 8;

/// Closes a queue when it is dropped: its threads end once nothing is left in it.
pub(crate) struct CloseOnDrop<T: Entry>(pub(crate) Arc<Queue<T>>);

impl<T: Entry> Drop for CloseOnDrop<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// Starts the threads of the audio frontend, one per core but at least two, and one for each of
/// `songs`, so that a long one does not keep all others waiting. They end when the returned queue
/// is closed and empty; the last of them closes the scheduler's.
///
/// # Errors
/// [`EngineError::NoThread`].
pub(crate) fn start_frontends(
    preparer: Preparer,
    songs: usize,
    capacity: usize,
) -> Result<(Arc<Preparer>, CloseOnDrop<AudioRequest>), EngineError> {
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let queue = CloseOnDrop(Arc::new(Queue::new(capacity)));
    let scheduled = Arc::new(CloseOnDrop(Arc::clone(&preparer.scheduled)));
    let preparer = Arc::new(preparer);
    for number in 0..cores.clamp(2, MOST_FRONTENDS).max(songs) {
        let audio = Arc::clone(&queue.0);
        let (preparer, scheduled) = (Arc::clone(&preparer), Arc::clone(&scheduled));
        thread::Builder::new()
            .name(format!("frontend-{number}"))
            .spawn(move || {
                let _scheduled = scheduled;
                while let Some(request) = audio.pop() {
                    prepare(&preparer, request);
                }
            })
            .map_err(EngineError::NoThread)?;
    }
    Ok((preparer, queue))
}

fn prepare(preparer: &Preparer, request: AudioRequest) {
    if !request.is_wanted() {
        return;
    }
    let completion = Arc::clone(&request.request.completion);
    let span = request.request.prologue.span.clone();
    let prepared = span.in_scope(|| guarded(|| preparer.schedule_audio(request)));
    if let Err(error) = prepared {
        completion.complete(Err(error));
    }
}

/// Starts the scheduler's thread, which ends when the queue is closed and nothing is left to do, or
/// can be done.
///
/// # Errors
/// [`EngineError::NoThread`].
pub(crate) fn start_scheduler(
    mut scheduler: Scheduler,
    queue: Arc<Queue<ScheduledRequest>>,
) -> Result<(), EngineError> {
    // Whatever ends the thread, nobody waits for it any longer.
    let abandon = AbandonOnDrop(queue);
    thread::Builder::new()
        .name("scheduler".into())
        .spawn(move || {
            let abandon = abandon;
            while take_requests(&mut scheduler, &abandon.0) {
                scheduler.step();
                if scheduler.has_stopped() {
                    return;
                }
            }
        })
        .map_err(EngineError::NoThread)?;
    Ok(())
}

/// Adds requests while there are places, and waits for one where there is nothing else to do.
/// Returns whether there is something to do.
fn take_requests(scheduler: &mut Scheduler, queue: &Queue<ScheduledRequest>) -> bool {
    while scheduler.has_place() {
        let request = match scheduler.is_idle() {
            true => queue.pop(),
            false => queue.try_pop(),
        };
        match request {
            Some(request) => scheduler.add(request),
            None => break,
        }
    }
    !scheduler.is_idle()
}

struct AbandonOnDrop(Arc<Queue<ScheduledRequest>>);

impl Drop for AbandonOnDrop {
    fn drop(&mut self) {
        self.0.abandon();
    }
}
