//! The default model and the demo song.

use std::{path::Path, sync::OnceLock};

use bailando::{
    audio::AudioLimits,
    engine::{Choreographer, DEFAULT_BATCH, EngineConfig},
};

/// The default model, loaded once.
pub(crate) fn choreographer() -> &'static Choreographer {
    static MODEL: OnceLock<Choreographer> = OnceLock::new();
    MODEL.get_or_init(|| {
        Choreographer::open(&EngineConfig {
            model_dir: Path::new(env!("CARGO_MANIFEST_DIR")).join("models/default"),
            threads: 2,
            batch: DEFAULT_BATCH.get(),
            queue: 8,
            audio: AudioLimits::default(),
            observer: std::sync::Arc::new(()),
        })
        .unwrap()
    })
}
