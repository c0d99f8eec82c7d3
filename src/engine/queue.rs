//! A bounded queue between threads that gives up cancelled requests first.

use std::collections::VecDeque;

use parking_lot::{Condvar, Mutex};

use super::EngineError;

/// Something in a [`Queue`].
pub(crate) trait Entry {
    /// Whether somebody still waits for its result.
    fn is_wanted(&self) -> bool;
}

/// First in, first out; at most `capacity` wait.
#[derive(Debug)]
pub(crate) struct Queue<T> {
    state: Mutex<State<T>>,
    /// Notified of every new entry, and of the end.
    changed: Condvar,
    capacity: usize,
}

#[derive(Debug)]
struct State<T> {
    waiting: VecDeque<T>,
    closed: bool,
}

impl<T: Entry> Queue<T> {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            state: Mutex::new(State { waiting: VecDeque::new(), closed: false }),
            changed: Condvar::new(),
            capacity: capacity.max(1),
        }
    }

    /// Puts `entry` at the end. Where the queue is full, cancelled entries give way.
    ///
    /// # Errors
    /// [`EngineError::QueueFull`], or [`EngineError::Stopped`] once the queue is closed.
    pub(crate) fn push(&self, entry: T) -> Result<(), EngineError> {
        let mut state = self.state.lock();
        if state.closed {
            return Err(EngineError::Stopped);
        }
        if state.waiting.len() >= self.capacity {
            state.waiting.retain(Entry::is_wanted);
        }
        if state.waiting.len() >= self.capacity {
            return Err(EngineError::QueueFull { capacity: self.capacity });
        }
        state.waiting.push_back(entry);
        self.changed.notify_one();
        Ok(())
    }

    /// Takes the first entry; waits for one. `None` once the queue is closed and empty.
    pub(crate) fn pop(&self) -> Option<T> {
        let mut state = self.state.lock();
        loop {
            if let Some(entry) = state.waiting.pop_front() {
                return Some(entry);
            }
            if state.closed {
                return None;
            }
            self.changed.wait(&mut state);
        }
    }

    /// Takes the first entry, if one waits.
    pub(crate) fn try_pop(&self) -> Option<T> {
        self.state.lock().waiting.pop_front()
    }

    /// Accepts nothing more; what waits may still be taken.
    pub(crate) fn close(&self) {
        self.state.lock().closed = true;
        self.changed.notify_all();
    }

    /// Drops what waits and accepts nothing more.
    pub(crate) fn abandon(&self) {
        self.close();
        let waiting = std::mem::take(&mut self.state.lock().waiting);
        // Outside the lock: their callers are told.
        drop(waiting);
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.state.lock().closed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq)]
    struct Wanted(char, bool);

    impl Entry for Wanted {
        fn is_wanted(&self) -> bool {
            self.1
        }
    }

    #[test]
    fn entries_leave_in_order_and_unwanted_ones_give_way() {
        let queue = Queue::new(2);
        queue.push(Wanted('a', false)).unwrap();
        queue.push(Wanted('b', true)).unwrap();
        queue.push(Wanted('c', true)).unwrap();
        let refused = queue.push(Wanted('d', true)).unwrap_err();
        assert!(matches!(refused, EngineError::QueueFull { capacity: 2 }));
        queue.close();
        let refused = queue.push(Wanted('d', true)).unwrap_err();
        assert!(matches!(refused, EngineError::Stopped));
        let left = [queue.pop(), queue.try_pop(), queue.try_pop(), queue.pop()];
        let names = left.map(|entry| entry.map(|entry| entry.0));
        assert_eq!(names, [Some('b'), Some('c'), None, None]);
    }

    #[test]
    fn an_abandoned_queue_is_empty() {
        let queue = Queue::new(2);
        queue.push(Wanted('a', true)).unwrap();
        queue.abandon();
        assert!(queue.is_closed());
        assert_eq!(queue.pop(), None);
    }
}
