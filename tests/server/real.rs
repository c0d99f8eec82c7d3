//! The service over a tiny model, with real and with broken audio.

use std::{
    num::NonZeroUsize,
    panic::panic_any,
    sync::{Arc, LazyLock},
    time::{Duration, Instant},
};

use axum::{Router, http::StatusCode};
use bailando::{
    engine::{
        Engine, EngineError, Generation, GenerationOptions, GenerationRequest, Pending, Progress,
        Stage,
    },
    model::Manifest,
    motion::Positions,
    server::{Access, Generate, Limits, ServerConfig, router},
};
use serde_json::Value;

use bailando_testkit::{
    model::tiny_dancer,
    song,
    wav::{SilentFlac, wav, wav_declaring, wav16},
};

use crate::server::{
    client::{Answer, form, get, post, raw, send},
    streaming::{in_lines, lines},
};

/// One model for all tests.
static MODEL: LazyLock<Engine> = LazyLock::new(|| {
    let config = ServerConfig { model_dir: tiny_dancer(), ..ServerConfig::default() };
    Engine::open(&config.engine(Arc::new(()))).unwrap()
});

pub(crate) fn service() -> Router {
    service_within(Limits::default())
}

pub(crate) fn service_within(limits: Limits) -> Router {
    let engine: Arc<dyn Generate> = Arc::new(MODEL.clone());
    router(engine, limits, Access::default())
}

fn codes(answer: &Answer) -> Value {
    assert_eq!(answer.status, StatusCode::OK, "{}", answer.json());
    answer.json()["codes"].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_container_becomes_json_and_bvh_of_its_length() {
    const SECONDS: f64 = 4.0;
    let service = service();
    for name in ["demo.mp3", "demo.flac", "demo.ogg", "demo.m4a", "demo_44k1_8s.wav"] {
        let query = format!("seed=3&duration_s={SECONDS}");
        let answer = send(&service, raw(&query, song(name))).await;
        assert_eq!(answer.status, StatusCode::OK, "{name}: {}", answer.json());
        let dance = answer.json();
        let frames = dance["frames"].as_f64().unwrap();
        assert!((frames - SECONDS * 60.0).abs() <= 8.0, "{name}: {frames}");
        assert_eq!(dance["positions"].as_array().unwrap().len() as f64, frames);
        assert!(dance["music"]["tempo_bpm"].as_f64().unwrap() > 0.0, "{name}");
        assert_eq!(dance["seed"], 3);
        let parts: [(&str, &[u8]); 3] = [("format", b"bvh"), ("fps", b"30"), ("file", &song(name))];
        let answer = send(&service, form(&query, &parts)).await;
        assert_eq!(answer.status, StatusCode::OK, "{name}");
        let bvh = String::from_utf8(answer.body).unwrap();
        let half = format!("Frames: {}\n", (frames / 2.0).ceil());
        assert!(bvh.starts_with("HIERARCHY"), "{name}");
        assert!(bvh.contains(&half), "{name} {half}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_song_becomes_every_format_on_every_skeleton() {
    let service = service();
    for (query, kind, start) in [
        ("format=bvh&skeleton=mixamo", "application/x-bvh", &b"HIERARCHY\nROOT mixamorigHips"[..]),
        ("format=bvh&skeleton=unreal", "application/x-bvh", b"HIERARCHY\nROOT root"),
        ("format=glb&skeleton=vrm", "model/gltf-binary", b"glTF"),
        ("format=vrma", "model/gltf-binary", b"glTF"),
        ("format=fbx&skeleton=unreal", "application/x-fbx", b"Kaydara FBX Binary"),
        ("format=vmd", "application/x-vmd", b"Vocaloid Motion Data 0002"),
        ("format=npz", "application/x-npz", b"PK"),
    ] {
        let query = format!("seed=3&duration_s=2&{query}");
        let answer = send(&service, raw(&query, song("demo.ogg"))).await;
        assert_eq!((answer.status, answer.header("content-type")), (StatusCode::OK, kind));
        assert!(answer.body.starts_with(start), "{query}");
        let name = answer.header("content-disposition");
        assert!(name.starts_with("attachment; filename=\"dance-3."), "{query}: {name}");
    }
}

/// Six seconds of a song's dance, and its third pair repeated for a minute: more than other options
/// may have bytes.
#[tokio::test(flavor = "multi_thread")]
async fn given_codes_become_every_format_without_a_song() {
    let service = service();
    let dance = send(&service, raw("seed=3&duration_s=6", song("demo.ogg"))).await;
    let mut given = codes(&dance);
    let text = given.to_string();
    let again = send(&service, form("seed=3&duration_s=6", &[("codes", text.as_bytes())])).await;
    assert_eq!(codes(&again), given);
    assert!(again.json()["positions"] == dance.json()["positions"]);
    for half in ["upper", "lower"] {
        let half = given[half].as_array_mut().unwrap();
        half.resize(450, half[2].clone());
    }
    let given = given.to_string();
    for (format, start) in [
        ("json", &b"{\"model\""[..]),
        ("bvh", b"HIERARCHY"),
        ("glb", b"glTF"),
        ("vrma", b"glTF"),
        ("fbx", b"Kaydara FBX Binary"),
        ("vmd", b"Vocaloid Motion Data 0002"),
        ("npz", b"PK"),
    ] {
        let parts: [(&str, &[u8]); 3] =
            [("codes", given.as_bytes()), ("format", format.as_bytes()), ("fps", b"30")];
        let answer = send(&service, form("", &parts)).await;
        assert_eq!(answer.status, StatusCode::OK, "{format}");
        assert!(answer.body.starts_with(start), "{format}");
        if format == "json" {
            assert_eq!(answer.json()["frames"], 1800);
        }
    }
    let mut streamed = in_lines(form("", &[("codes", given.as_bytes())]));
    *streamed.uri_mut() = "/generate/stream".parse().unwrap();
    let events = lines(&send(&service, streamed).await);
    assert_eq!(events[0]["frames"], 3600);
    assert_eq!(events.last().unwrap()["event"], "done");
    let wrong = form("", &[("codes", b"[[3, 4], [5, 99999]]")]);
    let said = send(&service, wrong).await.expect_error(400, "invalid_option");
    assert!(said.contains("number 2 of the lower codes is 99999"), "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_seed_repeats_and_another_differs() {
    let service = service();
    let ask = async |query: &str| {
        let query = format!("duration_s=8&music=false{query}");
        send(&service, raw(&query, song("demo.ogg"))).await
    };
    let first = ask("&seed=1").await;
    assert_eq!(codes(&first), codes(&ask("&seed=1").await));
    assert_ne!(codes(&first), codes(&ask("&seed=2").await));
    let drawn = ask("").await;
    let seed = drawn.header("x-seed").to_owned();
    assert_eq!(codes(&drawn), codes(&ask(&format!("&seed={seed}")).await));
    assert!(first.json().get("music").is_none());
    assert!(first.header("x-inference-time").parse::<f64>().unwrap() > 0.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn broken_audio_is_refused_quickly_and_the_dance_goes_on() {
    const HOURS: u64 = 10;
    let service = service();
    let flac = song("demo.flac");
    let silence = SilentFlac {
        rate: 44_100,
        channels: 8,
        frames: HOURS * 3_600 * 44_100,
        declared: HOURS * 3_600 * 44_100,
    };
    let png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR";
    let cases: Vec<(&str, Vec<u8>, u16)> = vec![
        ("text", b"this is not music".repeat(100), 415),
        ("one byte", b"x".to_vec(), 415),
        ("zip", [&b"PK\x03\x04"[..], &[0; 1_000]].concat(), 415),
        ("png", png.to_vec(), 415),
        ("half a flac header", flac[..20].to_vec(), 422),
        ("a flac header alone", flac[..42].to_vec(), 422),
        ("0-second wav", wav16(2, 44_100, &[]), 422),
        ("0.3 s wav", wav16(1, 44_100, &vec![1; 13_230]), 422),
        ("sample rate 0", wav(1, 0, 16, &[0; 1_000]), 422),
        ("sample rate of 4 GHz", wav(1, u32::MAX, 16, &[0; 1_000]), 422),
        ("10 h of silence", silence.bytes(), 422),
    ];
    for (name, audio, status) in cases {
        for request in [raw("", audio.clone()), form("", &[("file", &audio)])] {
            let started = Instant::now();
            let answer = send(&service, request).await;
            assert!(started.elapsed() < Duration::from_secs(1), "{name}");
            let error_type = answer.json()["error_type"].as_str().unwrap().to_owned();
            let said = answer.expect_error(status, &error_type);
            assert_ne!(error_type, "internal", "{name}: {said}");
        }
    }
    let good = send(&service, raw("duration_s=2", song("demo.mp3"))).await;
    assert_eq!(good.status, StatusCode::OK);
}

/// What a header declares is not believed: what is there is danced to, and the rest is reported.
#[tokio::test(flavor = "multi_thread")]
async fn a_wav_that_declares_too_much_is_danced_to_with_a_warning() {
    let noise: Vec<u8> = (0..176_400_u32).map(|i| (i.wrapping_mul(i) >> 3) as u8).collect();
    let truncated = wav_declaring(1, 44_100, 16, &noise, 20_000_000);
    let answer = send(&service(), raw("", truncated)).await;
    assert_eq!(answer.status, StatusCode::OK, "{}", answer.json());
    let dance = answer.json();
    assert!((dance["duration_s"].as_f64().unwrap() - 2.0).abs() <= 8.0 / 60.0);
    assert!(!dance["warnings"].as_array().unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn options_that_only_the_model_can_judge_are_refused() {
    let service = service();
    for query in ["start_upper=1000000", "start_lower=1000000", "hop=1000"] {
        send(&service, raw(query, song("demo.mp3"))).await.expect_error(400, "invalid_option");
    }
    send(&service, raw("offset_s=10000", song("demo.mp3")))
        .await
        .expect_error(400, "invalid_option");
}

#[tokio::test(flavor = "multi_thread")]
async fn info_is_that_of_the_model() {
    let info = get(&service(), "/info").await.json();
    assert_eq!(info["model"]["name"], MODEL.manifest().name);
    assert_eq!(info["model"]["manifest_sha256"], MODEL.model_sha256());
    assert_eq!(
        info["model"]["skeleton"]["joints"].as_array().unwrap().len(),
        MODEL.manifest().skeleton.joints.len()
    );
}

/// The engine with a fault in it, where the seed says so.
struct Faulty(Engine);

/// Panics at a stage.
struct Trap {
    stage: Stage,
    inner: Arc<dyn Progress>,
}

impl Progress for Trap {
    fn stage(&self, stage: Stage) {
        self.inner.stage(stage);
        if stage == self.stage {
            panic_any("a panic that the test wants");
        }
    }

    fn decoded(&self, seconds: f64) {
        self.inner.decoded(seconds);
    }

    fn codes(&self, done: usize, total: usize) {
        self.inner.codes(done, total);
        // On the scheduler's own thread, in the midst of its work.
        if self.stage == Stage::Generating && done * 2 > total {
            panic_any("a panic that the test wants");
        }
    }
}

impl Generate for Faulty {
    fn manifest(&self) -> &Manifest {
        self.0.manifest()
    }

    fn model_sha256(&self) -> &str {
        self.0.model_sha256()
    }

    fn is_alive(&self) -> bool {
        self.0.is_alive()
    }

    fn check(&self, options: &GenerationOptions) -> Result<(), EngineError> {
        self.0.check(options)
    }

    fn submit(&self, request: GenerationRequest) -> Generation {
        let stage = match request.options.seed {
            Some(101) => Stage::Decoding,
            Some(102) => Stage::Features,
            Some(103) => Stage::Generating,
            Some(104) => Stage::Motion,
            _ => return self.0.submit(request),
        };
        let inner = Arc::clone(&request.progress);
        let trap = Arc::new(Trap { stage, inner });
        self.0.submit(request.with_progress(trap))
    }

    fn pose(&self, codes: [u32; 2]) -> Pending<Positions> {
        self.0.pose(codes)
    }
}

/// RELIABILITY, row 9: a panic on any of the engine's threads costs its own request only, though
/// others share the model's steps with it.
#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_any_stage_costs_its_own_request_only() {
    let engine: Arc<dyn Generate> = Arc::new(Faulty(MODEL.clone()));
    let app = router(engine, Limits::default(), Access::default());
    let ask = |seed: u64| {
        let app = app.clone();
        let request = raw(&format!("seed={seed}&duration_s=4"), song("demo.ogg"));
        tokio::spawn(async move { send(&app, request).await })
    };
    let undisturbed = codes(&ask(1).await.unwrap());
    for faulty in [101, 102, 103, 104] {
        let (beside, panicking) = (ask(1), ask(faulty));
        panicking.await.unwrap().expect_error(500, "internal");
        assert_eq!(codes(&beside.await.unwrap()), undisturbed, "beside {faulty}");
        assert_eq!(codes(&ask(1).await.unwrap()), undisturbed, "after {faulty}");
    }
    let metrics = String::from_utf8(get(&app, "/metrics").await.body).unwrap();
    for place in ["decode", "features", "inference", "motion"] {
        let counted = format!("bailando_panics_total{{place=\"{place}\"}} 1");
        assert!(metrics.contains(&counted), "{metrics}");
    }
    assert!(metrics.contains("bailando_requests_running 0"));
}

/// RELIABILITY, row 11: one thread or two, alone or among others.
#[tokio::test(flavor = "multi_thread")]
async fn the_same_song_and_seed_are_the_same_dance_always() {
    let single = ServerConfig {
        threads: Some(NonZeroUsize::MIN),
        model_dir: tiny_dancer(),
        ..ServerConfig::default()
    };
    let single = Engine::open(&single.engine(Arc::new(()))).unwrap();
    let single = router(Arc::new(single), Limits::default(), Access::default());
    let ask = |app: &Router, seed: u64| {
        let app = app.clone();
        let request = raw(&format!("seed={seed}&duration_s=6"), song("demo.ogg"));
        tokio::spawn(async move { send(&app, request).await })
    };
    let alone = ask(&single, 7).await.unwrap();
    let service = service();
    let together: Vec<_> = [7, 8, 9, 7].map(|seed| ask(&service, seed)).into();
    let mut together_answers = Vec::new();
    for answer in together {
        together_answers.push(answer.await.unwrap());
    }
    for same in [0, 3] {
        let answer = &together_answers[same];
        assert_eq!(codes(answer), codes(&alone));
        let numbers = |answer: &Answer| -> Vec<f64> {
            let positions = answer.json()["positions"].to_string();
            let numbers = positions.split(['[', ']', ',']);
            numbers.filter_map(|number| number.parse().ok()).collect()
        };
        let (a, b) = (numbers(answer), numbers(&alone));
        assert_eq!(a.len(), b.len());
        let apart = a.iter().zip(&b).map(|(a, b)| (a - b).abs());
        let furthest = apart.fold(0.0, f64::max);
        assert!(furthest < 1e-5, "{furthest} m");
    }
    assert_ne!(codes(&together_answers[1]), codes(&alone));
}

/// A stream of the real model is its dance, to its end, and clips chain.
#[tokio::test(flavor = "multi_thread")]
async fn streams_jobs_and_chains_of_the_real_model() {
    let service = service();
    let dance = send(&service, raw("seed=3&duration_s=5", song("demo.mp3"))).await;
    let stream = post("/generate/stream", "seed=3&duration_s=5", song("demo.mp3"));
    let events = lines(&send(&service, in_lines(stream)).await);
    let (start, done) = (events.first().unwrap(), events.last().unwrap());
    assert_eq!(done["codes"], codes(&dance));
    assert_eq!(start["frames"], dance.json()["frames"]);
    assert_eq!(done["frames"], dance.json()["frames"]);
    assert_eq!(start["music"], dance.json()["music"]);
    let tail = dance.header("x-tail").to_owned();
    assert_eq!(dance.json()["tail"], tail);
    let query = format!("seed=4&offset_s=5&duration_s=5&continue_from={tail}");
    let next = send(&service, raw(&query, song("demo.mp3"))).await;
    assert_eq!(next.status, StatusCode::OK, "{}", next.json());
    let pose = get(&service, "/codes/1/2").await.json();
    assert_eq!((&pose["frames"], &pose["fps"]), (&32.into(), &60.into()));
}
