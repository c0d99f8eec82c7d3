//! The default model and the demo song.

use std::{path::Path, sync::OnceLock};

use bailando::{
    engine::{Engine, EngineConfig, GenerationOptions, GenerationRequest},
    formats::GeneratedMotion,
};

/// The default model, loaded once.
pub(crate) fn engine() -> &'static Engine {
    static MODEL: OnceLock<Engine> = OnceLock::new();
    MODEL.get_or_init(|| {
        let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/default");
        Engine::open(&EngineConfig { threads: 2, queue: 8, ..EngineConfig::new(model) }).unwrap()
    })
}

/// A dance of the default model.
pub(crate) fn dance_to(audio: Vec<u8>, options: &GenerationOptions) -> GeneratedMotion {
    let request = GenerationRequest::audio(audio, options.clone());
    let output = engine().generate(request).unwrap();
    output.into_motion(engine().manifest())
}
