//! Receiving the audio and the options that come with it; limits hold while reading.

use axum::{
    body::Body,
    extract::{DefaultBodyLimit, FromRequest, Multipart, Request, multipart::Field},
    http::{header, request::Parts},
};
use bytes::{Buf, Bytes, BytesMut};
use futures_util::{Stream, StreamExt, TryStreamExt};

use super::{
    body::{BodyError, IncomingBody},
    form::{FormBody, Kept, boundary, content_type},
    media::Media,
};
use crate::audio::is_lossless;
use crate::formats::FormatError;
use crate::server::{
    config::{ByteSize, FORM_OVERHEAD, Limits},
    error::ServerError,
    jobs::{options::JobOptions, song::SongWriter},
    options::{RequestOptions, longest_value, option_named, option_names, shorten},
    resources::UploadReservation,
    rig::RigParts,
};

/// Longest mapping of bones in bytes.
const LONGEST_MAPPING: usize = 16 * 1024;
/// Bytes that are handed to the store at once.
const PIECE: usize = 1 << 20;

/// A request that has arrived completely.
pub(crate) struct Upload {
    /// Empty where the options carry the codes to dance, or the song went to the store.
    pub(crate) audio: Bytes,
    /// The song of a job, all of it written.
    pub(crate) song: Option<SongWriter>,
    pub(crate) rig: RigParts,
    pub(crate) options: RequestOptions,
    /// What it has beside its dance, where it is a job.
    pub(crate) job: Option<JobOptions>,
}

/// What the query asks for.
pub(crate) struct Asked {
    pub(crate) options: RequestOptions,
    /// None where the request orders no job.
    pub(crate) job: Option<JobOptions>,
    /// Where the song of a job goes.
    pub(crate) song: Option<SongWriter>,
}

/// Refuses a body with a declared length above every limit.
///
/// # Errors
/// [`ServerError::TooLarge`].
pub(crate) fn check_declared(
    body: &IncomingBody,
    media: Media,
    limits: &Limits,
) -> Result<(), ServerError> {
    let most = most_bytes(media, limits);
    match body.declared() {
        Some(declared) if declared > most => Err(too_large(limits.payload_limit_lossless, limits)),
        _ => Ok(()),
    }
}

/// Reads the whole body. `asked` is what the query asks for; parts of a form add to them.
///
/// # Errors
/// [`ServerError`] for anything that is wrong with the upload.
pub(crate) async fn receive(
    parts: Parts,
    body: IncomingBody,
    media: Media,
    asked: Asked,
    limits: &Limits,
    reservation: &mut UploadReservation,
) -> Result<Upload, ServerError> {
    let body = body.limited(most_bytes(media, limits)).counted(reservation);
    let upload = match media {
        Media::Raw => {
            let Asked { options, job, mut song } = asked;
            let mut audio = AudioBuffer::new(limits, body.declared(), song.as_mut());
            collect(&mut audio, body, |error| body_error(&error, limits)).await?;
            let audio = audio.finish().await?;
            Upload { audio, song, rig: RigParts::default(), options, job }
        }
        Media::Form => receive_form(parts, body, asked, limits).await?,
    };
    reservation.received();
    let written = upload.song.as_ref().map_or(0, SongWriter::bytes);
    match upload.audio.is_empty() && written == 0 && upload.options.given_codes().is_none() {
        true => Err(ServerError::MissingAudio),
        false => Ok(upload),
    }
}

fn most_bytes(media: Media, limits: &Limits) -> u64 {
    match media {
        Media::Raw => limits.largest_file().0,
        Media::Form => limits.largest_body().0,
    }
}

async fn receive_form(
    mut parts: Parts,
    body: IncomingBody,
    Asked { mut options, mut job, mut song }: Asked,
    limits: &Limits,
) -> Result<Upload, ServerError> {
    let no_boundary = || {
        ServerError::Multipart(
            "the Content-Type of the form names no boundary: let the HTTP client set this header"
                .to_owned(),
        )
    };
    let boundary = boundary(&parts.headers).ok_or_else(no_boundary)?;
    let kind = content_type(&boundary).ok_or_else(no_boundary)?;
    parts.headers.insert(header::CONTENT_TYPE, kind);
    let body = FormBody::new(body, &boundary);
    let kept = body.kept();
    let mut request = Request::from_parts(parts, Body::from_stream(body));
    // Our own limits are larger than the framework's default of 2 MB, and finer.
    DefaultBodyLimit::disable().apply(&mut request);
    let mut form = Multipart::from_request(request, &())
        .await
        .map_err(|rejection| ServerError::Multipart(rejection.body_text()))?;
    let (mut audio, mut is_empty): (Option<Bytes>, bool) = (None, false);
    let mut rig = RigParts::default();
    while let Some(field) = form.next_field().await.map_err(|error| form_error(&error, limits))? {
        kept.delivered(0);
        let name = field.name().unwrap_or_default().to_owned();
        if name == "file" {
            if audio.is_some() {
                return Err(ServerError::Multipart(
                    "part `file` was sent more than once: send one song".to_owned(),
                ));
            }
            let mut buffer = AudioBuffer::new(limits, None, song.as_mut());
            let field = field.inspect_ok(|chunk| kept.delivered(chunk.len()));
            collect(&mut buffer, field, |error| form_error(&error, limits)).await?;
            is_empty = buffer.received == 0;
            audio = Some(buffer.finish().await?);
        } else if name == "rig" {
            if rig.file.is_some() {
                return Err(ServerError::Multipart(
                    "part `rig` was sent more than once: send one character".to_owned(),
                ));
            }
            rig.file = Some(read_rig(field, &kept, limits).await?);
        } else if name == "rig_mapping" {
            let value = read_value(field, &kept, LONGEST_MAPPING, limits).await?;
            if value.len() > LONGEST_MAPPING || rig.mapping.is_some() {
                let problem = format!("expected one of at most {LONGEST_MAPPING} bytes");
                return Err(ServerError::Option { name, problem });
            }
            rig.mapping = Some(value);
        } else {
            let value = read_value(field, &kept, longest_value(&name), limits).await?;
            let taken = job.as_mut().map_or(Ok(false), |job| job.take(&name, &value))?;
            if !taken {
                option_named(&name).ok_or_else(|| no_such_part(&name))?;
                options.set(&name, &value)?;
            }
        }
    }
    match is_empty {
        true => Err(ServerError::EmptyAudio),
        false => Ok(Upload { audio: audio.unwrap_or_default(), song, rig, options, job }),
    }
}

/// The usual reason is a song in a part of another name.
fn no_such_part(name: &str) -> ServerError {
    ServerError::Option {
        name: shorten(name),
        problem: format!(
            "there is no such part: the song goes in the part `file`, a character in `rig`, its \
             bones in `rig_mapping`; other parts are options: {}",
            option_names()
        ),
    }
}

/// Reads the caller's character.
async fn read_rig(
    mut field: Field<'_>,
    kept: &Kept,
    limits: &Limits,
) -> Result<Bytes, ServerError> {
    let most = limits.rig_limit.0 as usize;
    let mut bytes = BytesMut::new();
    while let Some(chunk) = field.chunk().await.map_err(|error| form_error(&error, limits))? {
        kept.delivered(chunk.len());
        if bytes.len() + chunk.len() > most {
            return Err(FormatError::RigTooLarge { limit: most }.into());
        }
        bytes.extend_from_slice(&chunk);
    }
    Ok(bytes.freeze())
}

/// Reads the value of an option. A value that is longer than `longest` is cut, and refused by its
/// parser.
async fn read_value(
    mut field: Field<'_>,
    kept: &Kept,
    longest: usize,
    limits: &Limits,
) -> Result<String, ServerError> {
    let mut value = Vec::new();
    while value.len() <= longest
        && let Some(chunk) = field.chunk().await.map_err(|error| form_error(&error, limits))?
    {
        kept.delivered(chunk.len());
        let room = (longest + 1).saturating_sub(value.len());
        value.extend(chunk.iter().take(room));
    }
    Ok(String::from_utf8_lossy(&value).into_owned())
}

async fn collect<E>(
    audio: &mut AudioBuffer<'_>,
    mut chunks: impl Stream<Item = Result<Bytes, E>> + Unpin,
    explain: impl Fn(E) -> ServerError,
) -> Result<(), ServerError> {
    while let Some(chunk) = chunks.next().await {
        audio.push(&chunk.map_err(&explain)?).await?;
    }
    Ok(())
}

/// Audio so far, up to the limit of the format that its first bytes name.
struct AudioBuffer<'a> {
    /// What has not gone to the store.
    bytes: BytesMut,
    received: u64,
    lossless: Option<bool>,
    // Only used to refuse early: no memory is reserved for it.
    declared: u64,
    limits: &'a Limits,
    song: Option<&'a mut SongWriter>,
}

impl<'a> AudioBuffer<'a> {
    fn new(limits: &'a Limits, declared: Option<u64>, song: Option<&'a mut SongWriter>) -> Self {
        let declared = declared.unwrap_or_default();
        let (bytes, received, lossless) = (BytesMut::new(), 0, None);
        Self { bytes, received, lossless, declared, limits, song }
    }

    async fn push(&mut self, chunk: &[u8]) -> Result<(), ServerError> {
        self.received += chunk.len() as u64;
        self.bytes.extend_from_slice(chunk);
        if self.lossless.is_none() {
            self.lossless = is_lossless(&self.bytes);
        }
        self.check(self.lossless.unwrap_or(true))?;
        // A tag in front, of whatever size, stays until the format behind it is known.
        match self.lossless {
            Some(_) => self.write(PIECE).await,
            None => Ok(()),
        }
    }

    /// Hands pieces to the store until fewer than `least` bytes are left.
    async fn write(&mut self, least: usize) -> Result<(), ServerError> {
        let Some(song) = &mut self.song else {
            return Ok(());
        };
        while !self.bytes.is_empty() && self.bytes.len() >= least {
            // A copy: the store would keep all of the buffer for a piece of it.
            let piece = Bytes::copy_from_slice(&self.bytes[..self.bytes.len().min(PIECE)]);
            self.bytes.advance(piece.len());
            song.push(piece).await?;
        }
        // What a large tag took is given back.
        if self.bytes.capacity() > 2 * PIECE {
            self.bytes = BytesMut::from(&self.bytes[..]);
        }
        Ok(())
    }

    fn check(&self, lossless: bool) -> Result<(), ServerError> {
        let limit = match lossless {
            true => self.limits.payload_limit_lossless,
            false => self.limits.payload_limit,
        };
        match self.declared.max(self.received) > limit.0 {
            true => Err(too_large(limit, self.limits)),
            false => Ok(()),
        }
    }

    /// Returns all audio that did not go to the store. A file that ends before it names its format
    /// is not lossless.
    async fn finish(mut self) -> Result<Bytes, ServerError> {
        self.check(self.lossless.unwrap_or(false))?;
        self.write(0).await?;
        Ok(self.bytes.freeze())
    }
}

fn too_large(limit: ByteSize, limits: &Limits) -> ServerError {
    ServerError::TooLarge {
        limit,
        lossy: limits.payload_limit,
        lossless: limits.payload_limit_lossless,
    }
}

fn body_error(error: &BodyError, limits: &Limits) -> ServerError {
    match error {
        BodyError::TooLarge => too_large(limits.payload_limit_lossless, limits),
        BodyError::TooSlow => ServerError::UploadTimeout {
            idle: limits.body_idle_timeout,
            total: limits.body_timeout,
            rate: limits.body_least_rate,
        },
        BodyError::Displaced => {
            ServerError::UploadDisplaced { retry_after: limits.body_idle_timeout }
        }
        BodyError::NoRoom { retry_after } => {
            ServerError::UploadMemory { memory: limits.upload_memory, retry_after: *retry_after }
        }
        BodyError::FormOverhead => ServerError::Multipart(format!(
            "the form holds more than {} beside what its parts carry",
            ByteSize(FORM_OVERHEAD)
        )),
        BodyError::FormLines => ServerError::Multipart(
            "the lines of the form's boundaries and headers end with LF: end them with CR LF, as \
             HTTP clients do"
                .to_owned(),
        ),
        BodyError::Broken(_) => ServerError::UploadBroken,
    }
}

/// Explains an error of the form's parser. Errors of the body pass through the parser, and are
/// found again among its sources.
fn form_error(error: &axum::extract::multipart::MultipartError, limits: &Limits) -> ServerError {
    let mut source: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = source {
        if let Some(error) = error.downcast_ref::<BodyError>() {
            return body_error(error, limits);
        }
        source = error.source();
    }
    ServerError::Multipart(format!("the form cannot be read: {}", shorten(&error.body_text())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn an_id3_tag_in_front_leaves_flac_and_wav_their_larger_limit() {
        let limits = Limits {
            payload_limit: ByteSize(64),
            payload_limit_lossless: ByteSize(256),
            ..Limits::default()
        };
        for (audio, accepted) in
            [(b"fLaC".as_slice(), true), (b"RIFF\0\0\0\0WAVE", true), (b"\xff\xfb\x90\0", false)]
        {
            let file = [b"ID3\x04\0\0\0\0\0\x02xx".as_slice(), audio, &[0; 100]].concat();
            let mut buffer = AudioBuffer::new(&limits, None, None);
            let mut fits = true;
            for chunk in file.chunks(10) {
                fits &= buffer.push(chunk).await.is_ok();
            }
            assert_eq!(fits, accepted, "{audio:?}");
        }
    }
}
