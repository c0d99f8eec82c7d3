//! Judgements of the model that ships, `models/default`: whether its motion looks like dancing.
//!
//! These are no tests of code. A new default model may change their figures, and nothing else may
//! depend on it: all other tests run the tiny models of the test kit.

mod choices;
mod model;
mod motion;

use std::sync::LazyLock;

use bailando::engine::Engine;
use bailando_testkit::project;

use crate::support;

/// The default model, loaded once.
static DEFAULT: LazyLock<Engine> = LazyLock::new(|| support::open(&project("models/default")));
