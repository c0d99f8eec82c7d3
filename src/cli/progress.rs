//! A progress bar on a terminal; nothing elsewhere.

use std::time::Duration;

use bailando::engine::{Progress, Stage};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::console::Talk;

/// While it is not known how many codes there will be.
const BEFORE: &str = "{prefix} {msg:10} {spinner}";
const GENERATING: &str = "{prefix} {msg:10} [{bar:32}] {pos}/{len} codes, {eta} left";

/// Shows one song's progress on standard error when that is a terminal.
pub(super) struct Bar {
    bar: ProgressBar,
}

impl Bar {
    pub(super) fn new(name: &str) -> Self {
        let bar = ProgressBar::no_length().with_prefix(name.to_owned());
        if Talk::is_quiet() {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        set_style(&bar, BEFORE);
        bar.enable_steady_tick(Duration::from_millis(200));
        Self { bar }
    }
}

/// Without its template the bar has another look, and works.
fn set_style(bar: &ProgressBar, template: &str) {
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
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
        if self.bar.length().is_none() {
            set_style(&self.bar, GENERATING);
            // The time left is told from the codes alone, not from what came before them.
            self.bar.reset_eta();
        }
        self.bar.set_length(total as u64);
        self.bar.set_position(done as u64);
    }
}
