//! What every route that works does first: check, receive, and only then let the work begin.

use std::sync::Arc;

use axum::http::{HeaderMap, Uri, request::Parts};
use bytes::Bytes;
use tracing::Instrument;

use super::{
    error::ServerError,
    jobs::{options::JobOptions, song::SongWriter},
    layers::client::Client,
    options::RequestOptions,
    resources::{Stay, UploadReservation},
    response::{
        encoding::Encoding,
        negotiate::{self, Shape},
    },
    rig::Rig,
    state::{Generate, SharedState},
    tracker::{Phase, RequestTracker, Waiting},
    upload::{self, body::IncomingBody, media::Media},
};
use crate::formats::OutputFormat;

/// What becomes of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// A dance as the answer.
    Dance,
    /// The same in a format that is no JSON.
    File,
    /// Events while it is made.
    Stream,
    /// A dance that is fetched later.
    Job,
}

/// A dance that was ordered: everything is here, and nothing is wrong with it that can be told now.
pub(crate) struct Order {
    pub(crate) engine: Arc<dyn Generate>,
    pub(crate) client: Client,
    pub(crate) audio: Bytes,
    /// The song of a job, which is in the store once it is kept.
    pub(crate) song: Option<SongWriter>,
    pub(crate) options: RequestOptions,
    /// The caller's own character.
    pub(crate) rig: Option<Rig>,
    pub(crate) shape: Shape,
    /// What the upload holds, until the work begins.
    pub(crate) upload: Option<UploadReservation>,
    /// What it has beside its dance, where it is a job.
    pub(crate) job: JobOptions,
    pub(crate) tracker: Arc<RequestTracker>,
    pub(crate) waiting: Waiting,
}

/// Checks everything that costs nothing, takes a place for the body, and only then reads it
/// (RELIABILITY, defence 2). The caller waits for a permit afterwards: a slow upload takes none.
pub(crate) async fn receive(
    state: &SharedState,
    purpose: Purpose,
    parts: Parts,
    body: IncomingBody,
) -> Result<Order, ServerError> {
    let limits = &state.limits;
    let engine = state.engine()?;
    let media = Media::of(&parts.headers)?;
    let (job, uri) = job_options(purpose, &parts)?;
    let options = RequestOptions::from_query(&uri)?;
    engine.check(&options.generation(OutputFormat::Json))?;
    upload::check_declared(&body, media, limits)?;
    let accept = parts.headers.clone();
    // Only a form may still name a format that makes its Accept header irrelevant.
    if options.format.is_some() || media == Media::Raw {
        shape(purpose, &options, &accept)?;
    }
    let client = Client::of(&parts.extensions);
    match purpose {
        Purpose::Job => {
            job.check(&state.callbacks)?;
            state.jobs.check_room(client).await?;
        }
        Purpose::Dance | Purpose::File | Purpose::Stream => {
            state.resources.admission.check_room(client)?;
            state.resources.check_unread(client)?;
        }
    }

    let tracker = RequestTracker::new(Arc::clone(&state.metrics));
    let waiting = Waiting::of(&tracker);
    let received = async {
        let mut place = state.resources.uploads.begin(client)?;
        let body = body.timed(limits);
        let orders = purpose == Purpose::Job;
        let writer = || SongWriter::new(&state.jobs, Arc::clone(&state.metrics));
        let song = orders.then(writer);
        let asked = upload::Asked { options, job: orders.then_some(job), song };
        let upload = upload::receive(parts, body, media, asked, limits, &mut place)
            .instrument(tracing::info_span!("stage", otel.name = "upload"))
            .await?;
        let job = upload.job.clone().unwrap_or_default();
        job.check(&state.callbacks)?;
        let held = (limits, &state.metrics);
        // Reading takes memory and processors: who sends many characters waits in turn.
        let _turn = match upload.rig.file {
            Some(_) => Some(state.resources.writers.admit(client, Stay::Short).await?),
            None => None,
        };
        let rig = Rig::read(upload.rig, &upload.options, place.bytes(), held).await?;
        let shape = match &rig {
            Some(_) if purpose != Purpose::Dance => {
                return Err(ServerError::Multipart(
                    "a part `rig` goes with POST /generate alone".to_owned(),
                ));
            }
            Some(rig) => Shape {
                format: rig.motion_format(),
                encoding: Encoding::preferred(&accept),
                lines: false,
            },
            None => shape(purpose, &upload.options, &accept)?,
        };
        engine.check(&upload.options.generation(shape.format))?;
        let (audio, song) = (upload.audio, upload.song);
        Ok::<_, ServerError>((audio, song, upload.options, rig, job, shape, place))
    };
    let (audio, song, options, rig, job, shape, place) = match received.await {
        Ok(received) => received,
        Err(error) => {
            waiting.answered();
            return Err(error);
        }
    };
    tracker.enter(Phase::Queue);
    Ok(Order {
        engine: Arc::clone(engine),
        client,
        audio,
        song,
        options,
        rig,
        shape,
        upload: Some(place),
        job,
        tracker,
        waiting,
    })
}

/// What a job has beside its dance, and the query without it.
fn job_options(purpose: Purpose, parts: &Parts) -> Result<(JobOptions, Uri), ServerError> {
    let mut job = JobOptions::default();
    if purpose != Purpose::Job {
        return Ok((job, parts.uri.clone()));
    }
    job.take_headers(&parts.headers)?;
    let rest = job.take_query(&parts.uri)?;
    Ok((job, rest))
}

fn shape(
    purpose: Purpose,
    options: &RequestOptions,
    headers: &HeaderMap,
) -> Result<Shape, ServerError> {
    let encoding = Encoding::preferred(headers);
    match purpose {
        Purpose::Dance => Ok(Shape {
            format: match options.format {
                Some(format) => format,
                None => negotiate::dance(headers, OutputFormat::default())?,
            },
            encoding,
            lines: false,
        }),
        Purpose::File => match options.format {
            None => Ok(Shape { format: OutputFormat::Bvh, encoding, lines: false }),
            Some(OutputFormat::Json) => Err(ServerError::Option {
                name: "format".to_owned(),
                problem: "this route gives files; POST /generate gives json".to_owned(),
            }),
            Some(format) => Ok(Shape { format, encoding, lines: false }),
        },
        // The answer to the order itself is JSON always.
        Purpose::Job => {
            Ok(Shape { format: options.format.unwrap_or_default(), encoding, lines: false })
        }
        Purpose::Stream if options.bars_wanted().is_some() => Err(ServerError::Option {
            name: if options.bars.is_some() { "bars" } else { "loop" }.to_owned(),
            problem: "a stream is of all bars: send it to POST /generate or POST /jobs".to_owned(),
        }),
        Purpose::Stream => match options.format {
            None | Some(OutputFormat::Json) => Ok(Shape {
                format: OutputFormat::Json,
                encoding: Encoding::Identity,
                lines: negotiate::events_as_lines(headers)?,
            }),
            Some(other) => Err(ServerError::Option {
                name: "format".to_owned(),
                problem: format!("a stream has no {}, expected json", other.name()),
            }),
        },
    }
}
