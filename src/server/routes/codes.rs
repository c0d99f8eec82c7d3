//! `GET /codes`: the choreographic memory.

use std::sync::Arc;

use axum::{
    Json,
    extract::{Extension, Path, State, rejection::PathRejection},
    http::header,
    response::{IntoResponse, Response},
};
use serde::Serialize;
use utoipa::ToSchema;

use crate::{
    codebook::Memory,
    engine::EngineError,
    formats::{CodePoseJson, pose_json},
    model::SuppressedCodes,
    server::{
        blocking::blocking,
        error::ServerError,
        layers::client::Client,
        resources::Stay,
        response::documented::{CodePoseErrors, CodebookErrors},
        state::SharedState,
    },
};

/// The two codebooks.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct Codebooks {
    /// Pose codes of the upper half of the body: 0 to one less than this.
    #[schema(example = 512)]
    upper: usize,
    /// Pose codes of the lower half.
    #[schema(example = 512)]
    lower: usize,
    /// Frames that a pair of codes stands for, at `fps`.
    frames_per_code: usize,
    fps: u32,
    /// Joints that the upper half moves, by their numbers in the skeleton.
    upper_joints: Vec<usize>,
    /// Joints that the lower half moves.
    lower_joints: Vec<usize>,
    /// Pairs (upper, lower) that dances start from; any pair where there are none.
    start_codes: Vec<[u32; 2]>,
    /// Codes that are never drawn: what a dancer cannot do alone, say. They can be given all the
    /// same.
    suppressed_codes: SuppressedCodes,
    /// How often the training used each code, and what came next; absent where the model does not
    /// say.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    memory: Option<Memory>,
}

/// Describes the two codebooks.
#[utoipa::path(
    get,
    path = "/codes",
    operation_id = "get_codebooks",
    tag = "codes",
    responses(
        (status = 200, description = "The codebooks.", body = Codebooks),
        CodebookErrors,
    )
)]
pub(crate) async fn codebooks(
    State(state): State<SharedState>,
) -> Result<Json<Codebooks>, ServerError> {
    let engine = &state.loaded()?.engine;
    let manifest = engine.manifest();
    Ok(Json(Codebooks {
        upper: manifest.vocabulary.upper,
        lower: manifest.vocabulary.lower,
        frames_per_code: manifest.frames_per_code,
        fps: manifest.fps,
        upper_joints: manifest.upper_joints.clone(),
        lower_joints: manifest.lower_joints.clone(),
        start_codes: manifest.start_codes.clone(),
        suppressed_codes: manifest.suppressed_codes.clone(),
        memory: engine.memory().cloned(),
    }))
}

/// Shows what a pair of pose codes looks like: the pair repeated and decoded.
#[utoipa::path(
    get,
    path = "/codes/{upper}/{lower}",
    operation_id = "get_code_pose",
    tag = "codes",
    params(
        ("upper" = u32, Path, description = "Code of the upper half of the body."),
        ("lower" = u32, Path, description = "Code of the lower half.")
    ),
    responses(
        (status = 200, description = "The motion.", body = CodePoseJson<'static>),
        CodePoseErrors,
    )
)]
pub(crate) async fn pose(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    codes: Result<Path<(u32, u32)>, PathRejection>,
) -> Result<Response, ServerError> {
    let Path((upper, lower)) = codes.map_err(|_| ServerError::Option {
        name: "codes".to_owned(),
        problem: "expected two whole numbers, /codes/{upper}/{lower}".to_owned(),
    })?;
    let _under_way = state.lifecycle.enter().ok_or_else(|| state.draining())?;
    let json = state.in_time(shown(&state, client, [upper, lower])).await?;
    Ok(([(header::CONTENT_TYPE, "application/json")], json).into_response())
}

async fn shown(
    state: &SharedState,
    client: Client,
    [upper, lower]: [u32; 2],
) -> Result<Vec<u8>, ServerError> {
    let engine = Arc::clone(state.engine()?);
    state.resources.admission.check_room(client)?;
    let permit = state.resources.admission.admit(client, Stay::Short).await?;
    let fps = engine.manifest().fps;
    let metrics = Arc::clone(&state.metrics);
    // A task of its own: the permit is held until the work has ended.
    let shown = tokio::spawn(async move {
        let _permit = permit;
        let positions = engine.pose([upper, lower]).await.map_err(of_code)?;
        let json = move || Ok(pose_json([upper, lower], fps, &positions)?);
        blocking(&metrics, "codes", json).await
    });
    let failed = |failed: tokio::task::JoinError| Err(ServerError::Internal(failed.to_string()));
    shown.await.unwrap_or_else(failed)
}

/// The engine knows the codes as those that a dance starts with.
fn of_code(error: EngineError) -> ServerError {
    match error {
        EngineError::Option { name, problem } => {
            ServerError::Option { name: name.trim_start_matches("start_").to_owned(), problem }
        }
        other => other.into(),
    }
}
