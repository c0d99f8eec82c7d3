//! A caller's own character: its dance over HTTP, and what is refused.

use axum::http::StatusCode;
use bailando::server::{ByteSize, Limits};
use bailando_testkit::{rigs, song};
use serde_json::Value;

use crate::server::{
    client::{app, form, post, refuse, send, with},
    fake::Fake,
    real::{service, service_within},
};

#[tokio::test(flavor = "multi_thread")]
async fn a_dance_comes_back_on_the_callers_own_bones() {
    let service = service();
    let song = song("demo.ogg");
    for (rig, extension, kind) in [
        (rigs::mixamo(1.7), "glb", "model/gltf-binary"),
        (rigs::vrm1(), "vrm", "model/gltf-binary"),
        (rigs::bvh_of_60_joints(), "bvh", "application/x-bvh"),
    ] {
        let parts: [(&str, &[u8]); 2] = [("rig", &rig.bytes), ("file", &song)];
        // With a rig, what is accepted else does not matter.
        let request = with(form("seed=3&duration_s=2", &parts), "accept", "application/json");
        let answer = send(&service, request).await;
        let text = String::from_utf8_lossy(&answer.body).into_owned();
        assert_eq!(answer.status, StatusCode::OK, "{}: {text}", rig.name);
        assert_eq!(answer.header("content-type"), kind);
        let name = format!("attachment; filename=\"dance-3.{extension}\"");
        assert_eq!(answer.header("content-disposition"), name);
        assert!(answer.body.len() > rig.bytes.len() && answer.body[..4] == rig.bytes[..4]);
        let told = answer.header("x-rig-mapping").to_owned();
        let mapping: Value = serde_json::from_str(&told).unwrap();
        assert_eq!(mapping["bones"]["leftFoot"], rig.body.name("l_foot"), "{told}");
        if extension == "bvh" {
            assert!(text.contains("Frames: 120\r\n"), "{}", &text[..200]);
        }

        // The mapping that was told gives the same file.
        let parts = [parts[0], parts[1], ("rig_mapping", told.as_bytes())];
        let again = send(&service, form("seed=3&duration_s=2", &parts)).await;
        assert_eq!(again.status, StatusCode::OK);
        assert!(again.body == answer.body, "{}", rig.name);
    }
}

#[tokio::test]
async fn what_cannot_dance_is_refused_before_anything_else_is_done() {
    let fake = Fake::new();
    let app = app(&fake, &Limits { rig_bones: 60, ..Limits::default() });
    let glb = rigs::mixamo(1.7).bytes;
    let bvh = rigs::bvh_of_60_joints().bytes;
    let cut = glb[..glb.len() - 1].to_vec();
    for (parts, status, kind, expected) in [
        (vec![("rig", &b"no rig"[..])], 422, "unusable_rig", "neither BVH nor GLB"),
        (vec![("rig", b"")], 422, "unusable_rig", "neither BVH nor GLB"),
        (vec![("rig", &cut)], 422, "unusable_rig", "its header says"),
        (vec![("rig", &bvh)], 422, "unusable_rig", "more than 60 bones"),
        (vec![("rig", &glb), ("rig", &glb)], 400, "invalid_multipart", "more than once"),
        (vec![("rig", &glb), ("format", b"json")], 400, "invalid_option", "own kind of file, glb"),
        (vec![("rig", &glb), ("format", b"bvh")], 400, "invalid_option", "own kind of file, glb"),
        (vec![("rig_mapping", b"{\"bones\":{}}")], 400, "invalid_option", "no part `rig`"),
        (
            vec![("rig", &glb), ("rig_mapping", b"hips")],
            400,
            "invalid_option",
            "expected JSON such as",
        ),
        (
            vec![("rig", &glb), ("rig_mapping", b"{\"bones\":{\"hips\":\"x\"}}")],
            422,
            "unusable_rig",
            "`x`, which it does not have",
        ),
        // This model's skeleton is none that could lend its dance.
        (vec![("rig", &glb)], 400, "invalid_option", "the model's skeleton has no"),
    ] {
        let mut all = parts.clone();
        all.push(("file", b"song"));
        let error = refuse(&app, form("", &all), status, kind).await;
        assert!(error.contains(expected), "{expected}: {error}");
    }
    for path in ["/generate/stream", "/jobs"] {
        let mut request = post(path, "", "");
        let form = form("", &[("rig", &glb), ("file", b"song")]);
        *request.headers_mut() = form.headers().clone();
        *request.body_mut() = form.into_body();
        let error = refuse(&app, request, 400, "invalid_multipart").await;
        assert!(error.contains("`rig` goes with POST /generate alone"), "{error}");
    }
}

/// Thousands of joints for ten minutes would be gigabytes of text.
#[tokio::test(flavor = "multi_thread")]
async fn a_dance_that_all_answers_have_no_room_for_is_not_written() {
    let (rig, song) = (rigs::bvh_of_60_joints().bytes, song("demo.ogg"));
    let parts: [(&str, &[u8]); 2] = [("rig", &rig), ("file", &song)];
    for (memory, status) in [(500_000, 422_u16), (5_000_000, 200)] {
        let limits = Limits { answer_memory: ByteSize(memory), ..Limits::default() };
        let answer = send(&service_within(limits), form("duration_s=2", &parts)).await;
        assert_eq!(answer.status.as_u16(), status, "{memory}");
        if status == 422 {
            let said = answer.expect_error(422, "unusable_rig");
            assert!(said.contains("all answers have 500kB"), "{said}");
        }
    }
}

#[tokio::test]
async fn a_rig_may_have_its_own_limit_of_bytes() {
    let limit = |bytes: usize| Limits { rig_limit: ByteSize(bytes as u64), ..Limits::default() };
    let glb = rigs::mixamo(1.7).bytes;
    let parts: [(&str, &[u8]); 2] = [("rig", &glb), ("file", b"song")];
    let fake = Fake::new();
    let exact = app(&fake, &limit(glb.len()));
    let error = refuse(&exact, form("", &parts), 400, "invalid_option").await;
    assert!(error.contains("the model's skeleton"), "{error}");
    let small = app(&fake, &limit(glb.len() - 1));
    let error = refuse(&small, form("", &parts), 413, "payload_too_large").await;
    assert!(error.contains("the rig is larger than"), "{error}");
}
