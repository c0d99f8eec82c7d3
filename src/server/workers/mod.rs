//! The tasks that work on jobs, keep order among them, and report their ends.

mod lease;
mod reports;
mod store;
mod sweeper;
mod worker;

use std::sync::{Arc, atomic::Ordering};

use crate::server::{config::Role, state::SharedState};

/// Starts the tasks of this process, unless they run.
pub(crate) fn start(state: &SharedState) {
    if state.working.swap(true, Ordering::SeqCst) {
        return;
    }
    let limits = &state.limits;
    let workers = match state.role {
        // Requests that wait for their answer have the other half.
        Role::All => (limits.max_concurrent_requests.get() / 2).max(1),
        Role::Worker => limits.max_concurrent_requests.get(),
        Role::Api => 0,
    };
    let share = limits.share_of(workers as u64) as usize;
    let tasks = &state.lifecycle.background;
    for _ in 0..workers {
        tasks.spawn(worker::work(Arc::clone(state), share));
    }
    if workers > 0 {
        tasks.spawn(lease::say_alive(Arc::clone(state)));
    }
    tasks.spawn(sweeper::sweep(Arc::clone(state)));
    if !state.callbacks.allow.is_empty() {
        tasks.spawn(reports::report(Arc::clone(state)));
    }
}
