//! A bounded queue between request threads and the model's thread, from which a request that is
//! no longer wanted takes itself out again.

use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex, MutexGuard, PoisonError},
};

/// Why something was not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refused {
    /// As many wait as may wait.
    Full,
    /// Nobody takes from the queue any more.
    Closed,
}

/// First in, first out; at most `capacity` wait.
#[derive(Debug)]
pub(crate) struct Queue<T> {
    state: Mutex<State<T>>,
    // Told of everything that is put in, and of the end.
    changed: Condvar,
    capacity: usize,
}

#[derive(Debug)]
struct State<T> {
    waiting: VecDeque<(u64, T)>,
    next: u64,
    closed: bool,
}

impl<T> Queue<T> {
    pub(crate) fn new(capacity: usize) -> Self {
        let state = State {
            waiting: VecDeque::new(),
            next: 0,
            closed: false,
        };
        Self {
            state: Mutex::new(state),
            changed: Condvar::new(),
            capacity: capacity.max(1),
        }
    }

    pub(crate) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Puts `item` at the end; the number takes it out again.
    pub(crate) fn push(&self, item: T) -> Result<u64, Refused> {
        let mut state = self.state();
        if state.closed {
            return Err(Refused::Closed);
        }
        if state.waiting.len() >= self.capacity {
            return Err(Refused::Full);
        }
        let number = state.next;
        state.next += 1;
        state.waiting.push_back((number, item));
        self.changed.notify_one();
        Ok(number)
    }

    /// Takes the first out; waits for one. `None` once the queue is closed and empty.
    pub(crate) fn pop(&self) -> Option<T> {
        let mut state = self.state();
        loop {
            if let Some((_, item)) = state.waiting.pop_front() {
                return Some(item);
            }
            if state.closed {
                return None;
            }
            state = self
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Takes the first out, if one waits.
    pub(crate) fn try_pop(&self) -> Option<T> {
        self.state().waiting.pop_front().map(|(_, item)| item)
    }

    /// Takes the item with this number out, if it still waits.
    pub(crate) fn remove(&self, number: u64) -> Option<T> {
        let mut state = self.state();
        let place = state
            .waiting
            .iter()
            .position(|(other, _)| *other == number)?;
        state.waiting.remove(place).map(|(_, item)| item)
    }

    /// Lets nothing more in; what waits may still be taken out.
    pub(crate) fn close(&self) {
        self.state().closed = true;
        self.changed.notify_all();
    }

    /// Drops what waits and lets nothing more in.
    pub(crate) fn abandon(&self) {
        self.close();
        self.state().waiting.clear();
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.state().closed
    }

    fn state(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_leave_in_order_and_a_place_is_free_again() {
        let queue = Queue::new(2);
        let first = queue.push('a').unwrap();
        queue.push('b').unwrap();
        assert_eq!(queue.push('c'), Err(Refused::Full));
        assert_eq!(queue.remove(first), Some('a'));
        assert_eq!(queue.remove(first), None);
        queue.push('c').unwrap();
        queue.close();
        assert_eq!(queue.push('d'), Err(Refused::Closed));
        assert_eq!(
            (queue.pop(), queue.try_pop(), queue.try_pop(), queue.pop()),
            (Some('b'), Some('c'), None, None)
        );
    }

    #[test]
    fn an_abandoned_queue_is_empty() {
        let queue = Queue::new(2);
        queue.push(1).unwrap();
        queue.abandon();
        assert!(queue.is_closed());
        assert_eq!(queue.pop(), None);
    }
}
