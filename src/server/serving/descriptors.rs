//! Descriptors: every connection is one, and one that reads a stored result is two.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::server::config::Limits;

/// Descriptors of the process itself: its model, its database, its log.
const OWN: u64 = 64;

/// Lets the process open as many files as all places for connections may need, where the system
/// allows it: shells and systemd begin with 1,024.
pub(super) fn raise(limits: &Limits) {
    let wanted = 2 * limits.max_connections.get() as u64 + OWN;
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let Some(current) = current.filter(|current| *current < wanted) else { return };
    let raised = maximum.map_or(wanted, |maximum| maximum.min(wanted));
    let done = setrlimit(Resource::Nofile, Rlimit { current: Some(raised), maximum });
    let allowed = if done.is_ok() { raised } else { current };
    if allowed < wanted {
        tracing::warn!(
            allowed,
            wanted,
            "the system allows fewer open files than --max-connections may need (ulimit -n)"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_may_open_the_files_that_its_connections_need() {
        let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
        let few = Rlimit { current: Some(512), maximum };
        setrlimit(Resource::Nofile, few).unwrap();
        raise(&Limits::default());
        let wanted = 2 * 1024 + OWN;
        let current = Some(maximum.map_or(wanted, |maximum| maximum.min(wanted)));
        assert_eq!(getrlimit(Resource::Nofile), Rlimit { current, maximum });
    }
}
