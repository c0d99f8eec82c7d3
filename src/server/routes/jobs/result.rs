//! `GET /jobs/{id}/result`: a job's dance, in any format.

use std::sync::Arc;

use axum::{
    extract::{Extension, Path, State, rejection::PathRejection},
    http::{HeaderMap, HeaderValue, Uri, header},
    response::{IntoResponse, Response},
};
use bailando_jobs::{JobRecord, State as JobState};
use futures_util::StreamExt;

use super::{find::find, range};
use crate::{
    formats::from_stored,
    server::{
        blocking,
        error::ServerError,
        jobs::{
            order::{StoredOrder, StoredResult, from_text},
            service::{Jobs, Reader},
            status::report,
        },
        layers::{client::Client, envelope::Held},
        options::{OutputOptions, RequestOptions},
        response::{
            documented::{JobResultErrors, MotionResponse},
            encoding::Encoding,
            negotiate::{self, Shape},
            paced,
        },
        routes::generate::{Described, Rendered},
        state::SharedState,
    },
};

/// Gives a job's dance, in any format.
///
/// The options that say how a dance is written may be given again. Without `format` the Accept
/// header chooses; where it has no preference, the dance comes as it was ordered. `Range` asks for
/// a part of the bytes. A job that failed is answered as `POST /generate` would have been.
#[utoipa::path(
    get,
    path = "/jobs/{id}/result",
    operation_id = "get_job_result",
    tag = "jobs",
    params(
        ("id" = String, Path, description = "The job's id."),
        ("range" = Option<String>, Header, description = "Bytes that are asked for: one range."),
        OutputOptions,
    ),
    responses(
        MotionResponse,
        // Without a body: clients made of the document would take any dance for bytes.
        (status = 206, description = "The bytes that the header Range asks for."),
        JobResultErrors,
    )
)]
pub(crate) async fn result(
    State(state): State<SharedState>,
    Extension(client): Extension<Client>,
    id: Result<Path<String>, PathRejection>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ServerError> {
    let job = find(&state, client, id).await?;
    state.jobs.ask(job.id);
    let asked = RequestOptions::from_query(&uri)?;
    match job.state {
        JobState::Done => {}
        JobState::Failed => {
            let report = report(&job)?;
            state.jobs.fetched(job.id);
            return Ok(report.into_response());
        }
        unfinished => {
            let (id, state) = (job.id.to_string(), unfinished.name());
            return Err(ServerError::JobNotDone { id, state });
        }
    }
    let stored: StoredResult = from_text(job.id, job.result.as_deref().unwrap_or_default())?;
    let order: StoredOrder = from_text(job.id, &job.order)?;
    let (ordered, ordered_format) = order.read()?;
    let options = ordered.written_as(&asked)?;
    let format = match asked.format {
        Some(format) => format,
        None => negotiate::dance(&headers, ordered_format)?,
    };
    // A part is one of the bytes as they are.
    let encoding = match headers.contains_key(header::RANGE) {
        true => Encoding::Identity,
        false => Encoding::preferred(&headers),
    };
    let as_ordered = format == ordered_format && options.writing() == ordered.writing();
    // Whatever becomes of the connection, it counts until it has been sent.
    let reader = state.jobs.read(client)?;
    let mut wanted =
        Wanted { job, stored, client, options, shape: Shape { format, encoding, lines: false } };
    let as_it_is = |&size: &u64| encoding == Encoding::Identity || size > LARGEST_CODED;
    match wanted.stored.file_bytes.filter(|_| as_ordered).filter(as_it_is) {
        Some(size) => {
            wanted.shape.encoding = Encoding::Identity;
            wanted.send_file(&state, &headers, size, reader).await
        }
        None => wanted.write(&state, &headers, reader).await,
    }
}

/// Largest stored file that is written again for a client that wants it compressed, bytes. Larger
/// ones are sent as they come from the store.
const LARGEST_CODED: u64 = 8_000_000;

/// A result in a format.
struct Wanted {
    job: JobRecord,
    stored: StoredResult,
    client: Client,
    options: RequestOptions,
    shape: Shape,
}

impl Wanted {
    /// Sends the stored file, or a part of it, as it comes from the store.
    async fn send_file(
        self,
        state: &SharedState,
        headers: &HeaderMap,
        size: u64,
        reader: Reader,
    ) -> Result<Response, ServerError> {
        let part = range::asked(headers, &self.tag(), size)?;
        let under_way = (state.lifecycle.go_on(), reader);
        let name = Jobs::result(self.job.id, self.stored.start, self.shape.format.name());
        let (found, pieces) = state.jobs.files.read(&name, part.clone()).await?;
        if found != size {
            let problem = format!("{name} has {found} bytes in place of {size}");
            return Err(ServerError::Internal(problem));
        }
        let (told, id) = (Arc::clone(&state.jobs), self.job.id);
        // All of it, less what was sent.
        let mut left = part.is_none().then_some(size);
        // A file that ends early ends the response early: its length tells the reader.
        let sent = pieces.scan((), move |(), piece| {
            let _held = &under_way;
            let piece = piece.inspect_err(|error| {
                tracing::error!(%error, "a result broke off while it was sent");
            });
            let piece = piece.ok();
            let length = piece.as_ref().map_or(0, |piece| piece.len() as u64);
            left = left.map(|left| left.saturating_sub(length));
            if left == Some(0) {
                left = None;
                told.fetched(id);
            }
            std::future::ready(piece)
        });
        let body = paced::from_stream(sent, state.pace());
        let mut head = self.describe().headers();
        let status = range::describe(&mut head, &self.tag(), part, size);
        let mut response = (status, Held::Paced, head, body).into_response();
        response.extensions_mut().insert(Encoding::Identity);
        Ok(response)
    }

    /// Writes the dance in a format that is not stored, once for all readers.
    async fn write(
        self,
        state: &SharedState,
        headers: &HeaderMap,
        reader: Reader,
    ) -> Result<Response, ServerError> {
        let under_way = (state.lifecycle.go_on(), reader);
        let load = {
            let state = Arc::clone(state);
            let name = Jobs::result(self.job.id, self.stored.start, "motion");
            async move {
                let bytes = state.jobs.files.read_whole(&name).await?;
                let read = move || Ok(from_stored(&bytes)?);
                blocking::blocking(&state.metrics, "read", read).await
            }
        };
        let answers = state.jobs.answers(self.job.id);
        let held = (&state.resources, &state.metrics);
        let written = answers.get(held, self.client, load, &self.options, self.shape);
        let written = state.in_time(written).await?;
        let size = written.bytes().len() as u64;
        let part = range::asked(headers, &self.tag(), size)?;
        let rendered = Rendered::new(self.describe(), written);
        let (all, tag) = (part.is_none(), self.tag());
        let (told, id) = (Arc::clone(&state.jobs), self.job.id);
        let mut response = rendered.respond(state, part.clone(), under_way, move || {
            if all {
                told.fetched(id);
            }
        });
        *response.status_mut() = range::describe(response.headers_mut(), &tag, part, size);
        Ok(response)
    }

    fn describe(&self) -> Described {
        Described {
            // A rig goes with requests that are answered at once.
            rig: None,
            format: self.shape.format,
            seed: self.stored.seed,
            tail: self.stored.tail.clone(),
            timings: self.stored.timings(),
            warnings: self.stored.warnings.clone(),
        }
    }

    /// Names these bytes: those of another start of the job may differ in their times.
    fn tag(&self) -> HeaderValue {
        let writing = format!("{:?}", self.options.writing());
        let hash = writing.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
        });
        let (id, start, format) = (self.job.id, self.stored.start, self.shape.format.name());
        let coding = self.shape.encoding.name().unwrap_or("plain");
        HeaderValue::try_from(format!("\"{id}-{start}-{format}-{coding}-{hash:x}\""))
            .unwrap_or_else(|_| HeaderValue::from_static("\"\""))
    }
}
