//! `POST /generate`: ways to ask, ways to be answered.

use std::sync::atomic::Ordering;

use axum::{
    body::Body,
    http::{Request, StatusCode, header},
};
use bailando::server::Limits;

use crate::server::{
    client::{Answer, app, form, post, raw, refuse, send, succeed, with},
    fake::{Fake, LONG_DANCE, PANIC},
};

async fn ask(request: Request<Body>) -> Answer {
    send(&app(&Fake::new(), &Limits::default()), request).await
}

async fn ask_accepting(request: Request<Body>, accept: &str) -> Answer {
    ask(with(request, "accept", accept)).await
}

#[tokio::test]
async fn json_has_the_documented_shape() {
    let answer = ask(form("", &[("file", b"song"), ("include", b"rotations")])).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.header("content-type"), "application/json");
    insta::assert_json_snapshot!(answer.json());
}

#[tokio::test]
async fn form_and_raw_body_give_the_same() {
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    let options: [(&str, &[u8]); 3] = [("seed", b"5"), ("fps", b"30"), ("file", b"song")];
    let as_form = send(&app, form("", &options)).await;
    let as_mixed = send(&app, form("seed=5", &options[1..])).await;
    let as_raw = send(&app, raw("seed=5&fps=30", "song")).await;
    assert_eq!(as_form.status, StatusCode::OK);
    assert_eq!(as_form.body, as_raw.body);
    assert_eq!(as_form.body, as_mixed.body);
    assert_eq!(as_form.json()["fps"], 30);
    assert!(fake.heard.lock().unwrap().iter().all(|audio| audio == "song"));
}

#[tokio::test]
async fn a_form_without_files_is_refused_with_what_is_accepted() {
    let request = with(raw("", "song"), "content-type", "application/x-www-form-urlencoded");
    let answer = ask(request).await;
    let said = answer.expect_error(415, "unsupported_media_type");
    for words in ["multipart/form-data with part `file`", "audio/*", "--data-binary"] {
        assert!(said.contains(words), "{said}");
    }
}

#[tokio::test]
async fn a_raw_body_may_come_without_an_audio_type() {
    for kind in ["application/octet-stream", "audio/x-m4a", "video/webm;codecs=opus", "text/plain"]
    {
        let request = with(raw("", "song"), "content-type", kind);
        assert_eq!(ask(request).await.status, StatusCode::OK, "{kind}");
    }
    let mut request = raw("", "song");
    request.headers_mut().remove(header::CONTENT_TYPE);
    assert_eq!(ask(request).await.status, StatusCode::OK);
}

#[tokio::test]
async fn an_explicit_format_wins_over_accept() {
    let bvh = "application/x-bvh";
    for (query, accept, wanted) in [
        ("", "*/*", "application/json"),
        ("", "application/json", "application/json"),
        ("", bvh, bvh),
        ("format=bvh", "application/json", bvh),
        ("format=json", bvh, "application/json"),
        ("format=bvh", "text/html", bvh),
        ("", "model/gltf-binary", "model/gltf-binary"),
        ("format=fbx", "text/html", "application/x-fbx"),
    ] {
        let answer = ask_accepting(raw(query, "song"), accept).await;
        assert_eq!(
            (answer.status, answer.header("content-type")),
            (StatusCode::OK, wanted),
            "{query} {accept}"
        );
    }
    let answer = ask_accepting(raw("", "song"), "video/mp4").await;
    answer.expect_error(406, "not_acceptable");
    let answer = ask_accepting(form("", &[("file", b"x"), ("format", b"bvh")]), "*/*").await;
    assert_eq!(answer.header("content-type"), bvh);
}

#[tokio::test]
async fn the_route_for_files_gives_files_alone() {
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    let answer = send(&app, post("/generate/file", "seed=9", "song")).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.header("content-type"), "application/x-bvh");
    assert_eq!(answer.body, send(&app, raw("seed=9&format=bvh", "song")).await.body);
    let answer = send(&app, post("/generate/file", "format=glb", "song")).await;
    assert!(answer.body.starts_with(b"glTF"));
    let request = post("/generate/file", "format=json", "song");
    let said = refuse(&app, request, 400, "invalid_option").await;
    assert!(said.contains("POST /generate gives json"), "{said}");
}

#[tokio::test]
async fn bvh_and_glb_are_files_with_names() {
    let answer = ask(raw("format=bvh&seed=9", "song")).await;
    assert_eq!(answer.header("content-disposition"), "attachment; filename=\"dance-9.bvh\"");
    assert!(answer.body.starts_with(b"HIERARCHY"));
    let answer = ask(raw("format=glb&seed=9", "song")).await;
    assert_eq!(answer.header("content-disposition"), "attachment; filename=\"dance-9.glb\"");
    assert!(answer.body.starts_with(b"glTF"));
}

/// The skeleton of these tests has three joints.
#[tokio::test]
async fn a_skeleton_that_the_model_cannot_be_is_a_wrong_option() {
    let app = app(&Fake::new(), &Limits::default());
    for query in ["format=bvh&skeleton=mixamo", "format=vrma", "format=vmd", "format=npz"] {
        let said = refuse(&app, raw(query, "song"), 400, "invalid_option").await;
        assert!(said.contains("the model's"), "{query}: {said}");
    }
}

#[tokio::test]
async fn headers_tell_seed_and_times() {
    let answer = ask(raw("seed=9007199254740991", "song")).await;
    assert_eq!(answer.header("x-seed"), "9007199254740991");
    assert_eq!(answer.header("x-decode-time"), "0.2");
    assert_eq!(answer.header("x-feature-time"), "0.3");
    assert_eq!(answer.header("x-inference-time"), "0.4");
    let time = |name| answer.header(name).parse::<f64>().unwrap();
    assert!(time("x-queue-time") >= 0.1);
    assert!(time("x-total-time") > 0.0);
}

#[tokio::test]
async fn headers_tell_warnings_in_every_format() {
    for query in ["format=json", "format=bvh"] {
        let answer = ask(raw(query, "song")).await;
        assert_eq!(answer.header("x-warnings"), "a warning", "{query}");
        let length: usize = answer.header("content-length").parse().unwrap();
        assert_eq!(length, answer.body.len());
    }
}

#[tokio::test]
async fn a_sane_request_id_is_taken_over() {
    for (sent, taken) in [
        ("my-id_1.2:3/4+5=", true),
        ("with space", false),
        ("quote\"", false),
        ("", false),
        (&*"x".repeat(129), false),
    ] {
        let answer = ask(with(raw("fps=25", "song"), "x-request-id", sent)).await;
        answer.expect_error(400, "invalid_option");
        assert_eq!(answer.header("x-request-id") == sent, taken, "{sent}");
        assert!(!answer.header("x-request-id").is_empty());
    }
}

#[tokio::test]
async fn wrong_options_are_refused_before_any_work() {
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    let wrong = "fps=25 seed=-1 temperature=hot top_k=0 guidance=-1 candidates=0 \
                 style=waltz energy=2 energy=0.5 start_upper=512 window=wide hop=29 offset_s=-1 \
                 duration_s=0 root_motion=2 \
                 include=all encoding=hex bvh_unit=inch continue_from=abc format=mp4 \
                 skeleton=maya mannequin=2 codes=[1,2] codes=[[1,512]] codes=[] \
                 no_such_option=1 seed=1&seed=2 seed seed=%FF";
    for query in wrong.split(' ') {
        let name = query.split('=').next().unwrap();
        let said = refuse(&app, raw(query, "song"), 400, "invalid_option").await;
        assert!(said.contains(&format!("`{name}`")), "{said}");
        let value = query.split('=').nth(1).unwrap_or_default().as_bytes();
        let parts: [(&str, &[u8]); 2] = [(name, value), ("file", b"song")];
        if !query.contains('&') {
            refuse(&app, form("", &parts), 400, "invalid_option").await;
        }
    }
    let twice: [(&str, &[u8]); 2] = [("file", b"song"), ("seed", b"1")];
    refuse(&app, form("seed=1", &twice), 400, "invalid_option").await;
    assert_eq!(fake.generations.load(Ordering::SeqCst), 0);
    succeed(&app, raw("", "song")).await;
}

#[tokio::test]
async fn bodies_that_hold_no_audio_are_refused() {
    let app = app(&Fake::new(), &Limits::default());
    let forms: [&[(&str, &[u8])]; 3] = [&[("file", b"")], &[("seed", b"1")], &[]];
    for request in forms.map(|parts| form("", parts)).into_iter().chain([raw("", "")]) {
        refuse(&app, request, 400, "missing_audio").await;
    }
    let twice = form("", &[("file", b"a"), ("file", b"b")]);
    refuse(&app, twice, 400, "invalid_multipart").await;
    let broken = |kind: &str, body: &'static str| with(raw("", body), "content-type", kind);
    for (kind, body) in [
        ("multipart/form-data", "--x"),
        ("multipart/form-data; boundary=x", ""),
        ("multipart/form-data; boundary=x", "no boundary at all"),
        ("multipart/form-data; boundary=x", "--x\r\n"),
        ("multipart/form-data; boundary=x", "--x\r\nContent-Disposition: form-data; na"),
    ] {
        refuse(&app, broken(kind, body), 400, "invalid_multipart").await;
    }
    for request in [
        broken("application/json", "{}"),
        broken("text/html", "{}"),
        with(raw("", "song"), "content-encoding", "gzip"),
    ] {
        refuse(&app, request, 415, "unsupported_media_type").await;
    }
}

/// What HTTP clients of the field get wrong without meaning anything else.
#[tokio::test]
async fn forms_with_small_mistakes_are_taken_or_told_what_is_wrong() {
    const HEAD: &str = "--x\r\nContent-Disposition: form-data; name=\"file\"\r\n\r\nsong";
    let fake = Fake::new();
    let app = app(&fake, &Limits::default());
    let send_form = |kind: &str, body: String| with(raw("", body), "content-type", kind);
    for kind in ["multipart/form-data ; boundary=x ", "multipart/form-data; boundary=\"x\" ; a=b"] {
        succeed(&app, send_form(kind, format!("{HEAD}\r\n--x--\r\n"))).await;
        // The last boundary is missing.
        succeed(&app, send_form(kind, HEAD.to_owned())).await;
    }
    assert_eq!(fake.generations.load(Ordering::SeqCst), 4);
    for (kind, body, wanted) in [
        ("multipart/form-data", HEAD.to_owned(), "names no boundary"),
        ("multipart/form-data; boundary=x", HEAD.replace("\r\n", "\n"), "end them with CR LF"),
        ("multipart/form-data; boundary=x", HEAD.replace("song", "\r\n--x--"), "file"),
    ] {
        let error_type = if wanted == "file" { "missing_audio" } else { "invalid_multipart" };
        let said = refuse(&app, send_form(kind, body), 400, error_type).await;
        assert!(said.contains(wanted), "{said}");
    }
    succeed(&app, raw("root_motion=False&redo=True", "song")).await;
    for name in ["audio", "File", "sede"] {
        let said = refuse(&app, form("", &[(name, b"song")]), 400, "invalid_option").await;
        assert!(said.contains(&format!("`{name}`")) && said.contains("part `file`"), "{said}");
        assert!(said.contains("`rig`") && said.contains("seed"), "{said}");
    }
}

#[tokio::test]
async fn responses_are_compressed_for_who_asks_and_streams_are_not() {
    let app = app(&Fake::new(), &Limits::default());
    let document = || Request::get("/api-doc/openapi.json").body(Body::empty()).unwrap();
    let plain = send(&app, document()).await;
    let dance = || raw("seed=1", LONG_DANCE);
    let plain_dance = send(&app, dance()).await;
    assert_eq!(plain_dance.header("vary"), "accept-encoding");
    for answer in [&plain, &plain_dance] {
        assert!(!answer.headers.contains_key("content-encoding"));
    }
    for (encoding, magic) in [("gzip", &[0x1f, 0x8b][..]), ("zstd", &[0x28, 0xb5]), ("br", &[])] {
        let answer = send(&app, with(document(), "accept-encoding", encoding)).await;
        assert_eq!(answer.header("content-encoding"), encoding);
        assert!(answer.body.starts_with(magic) && answer.body.len() < plain.body.len() / 2);
        let answer = send(&app, with(dance(), "accept-encoding", encoding)).await;
        assert_eq!(answer.header("content-encoding"), encoding);
        assert_eq!(answer.header("content-length"), answer.body.len().to_string());
        assert!(answer.body.starts_with(magic));
        assert!(answer.body.len() < plain_dance.body.len() / 2);
        let stream = with(post("/generate/stream", "", "song"), "accept-encoding", encoding);
        assert!(!send(&app, stream).await.headers.contains_key("content-encoding"));
    }
}

#[tokio::test]
async fn a_panic_costs_its_own_request_only() {
    let app = app(&Fake::new(), &Limits::default());
    for _ in 0..5 {
        let said = refuse(&app, raw("", PANIC), 500, "internal").await;
        assert!(!said.contains("test wants"), "internals leaked: {said}");
    }
    succeed(&app, raw("", "song")).await;
}
