//! A progress bar on a terminal; nothing elsewhere.

use std::time::Duration;

use bailando::engine::{Progress, Stage};
use indicatif::{ProgressBar, ProgressStyle};

/// Shows one song's progress on standard error when that is a terminal.
pub(super) struct Bar {
    bar: ProgressBar,
}

impl Bar {
    pub(super) fn new(name: &str) -> Self {
        let bar = ProgressBar::new(0).with_prefix(name.to_owned());
        let template = "{prefix} {msg:10} [{bar:32}] {pos}/{len} codes, {eta} left";
        // Without its template the bar has another look, and works.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self { bar }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

impl Progress for Bar {
    fn stage(&self, stage: Stage) {
        self.bar.set_message(match stage {
            Stage::Decoding => "decoding",
            Stage::Features => "features",
            Stage::Generating => "generating",
            Stage::Motion => "motion",
        });
    }

    fn codes(&self, done: usize, total: usize) {
        self.bar.set_length(total as u64);
        self.bar.set_position(done as u64);
    }
}
