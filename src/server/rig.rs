//! A character of the caller's own, in a form beside the song.

use std::sync::Arc;

use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use bytes::Bytes;

use super::{
    blocking,
    config::Limits,
    error::ServerError,
    metrics::SharedMetrics,
    options::{RequestOptions, shorten},
    resources::HeldBytes,
};
use crate::formats::{Character, OutputFormat, RigFormat, RigLimits, RigMapping};

const MAPPING: HeaderName = HeaderName::from_static("x-rig-mapping");
/// Most bytes of a mapping as a header: clients and proxies take about twice as many in all.
const LONGEST_MAPPING: usize = 4096;
/// Place of panics.
const PLACE: &str = "rig";

/// The parts of a form that are about a character.
#[derive(Debug, Default)]
pub(crate) struct RigParts {
    pub(crate) file: Option<Bytes>,
    pub(crate) mapping: Option<String>,
}

/// A character whose bones are known.
pub(crate) struct Rig {
    pub(crate) character: Arc<Character>,
    /// Its bytes are held among those of uploads until the dance is written.
    _room: HeldBytes,
}

impl Rig {
    /// Reads the character of a form, off the async threads; none where there is none.
    ///
    /// # Errors
    /// [`ServerError`] for a file or a mapping that cannot be used, or an option that does not go
    /// with a character.
    pub(crate) async fn read(
        parts: RigParts,
        options: &RequestOptions,
        room: HeldBytes,
        (limits, metrics): (&Limits, &SharedMetrics),
    ) -> Result<Option<Self>, ServerError> {
        let mapping = parts.mapping.as_deref().map(mapping).transpose()?;
        let Some(file) = parts.file else {
            return match mapping {
                None => Ok(None),
                Some(_) => Err(refused("rig_mapping", "there is no part `rig` to go with it")),
            };
        };
        let limits = RigLimits { bytes: limits.rig_limit.0 as usize, bones: limits.rig_bones };
        let mapping = mapping.unwrap_or_default();
        let read =
            move || Character::read(file.into(), &mapping, &limits).map_err(ServerError::from);
        let character = blocking::blocking(metrics, PLACE, read).await?;
        check(options, character.format())?;
        Ok(Some(Self { character: Arc::new(character), _room: room }))
    }

    /// The format for which the dance is made.
    pub(crate) fn motion_format(&self) -> OutputFormat {
        match self.character.format() {
            RigFormat::Bvh => OutputFormat::Bvh,
            RigFormat::Glb | RigFormat::Vrm => OutputFormat::Glb,
        }
    }
}

fn refused(name: &str, problem: impl Into<String>) -> ServerError {
    ServerError::Option { name: name.to_owned(), problem: problem.into() }
}

fn mapping(text: &str) -> Result<RigMapping, ServerError> {
    serde_json::from_str(text).map_err(|error| {
        let error = shorten(&error.to_string());
        refused(
            "rig_mapping",
            format!("expected JSON such as {{\"bones\": {{\"hips\": \"pelvis\"}}}}: {error}"),
        )
    })
}

/// The dance comes back as the file that was sent.
fn check(options: &RequestOptions, rig: RigFormat) -> Result<(), ServerError> {
    let fits = match options.format {
        None => true,
        Some(OutputFormat::Bvh) => rig == RigFormat::Bvh,
        Some(OutputFormat::Glb) => rig != RigFormat::Bvh,
        Some(_) => false,
    };
    match fits {
        true => Ok(()),
        false => Err(refused(
            "format",
            format!("with a rig the result is the rig's own kind of file, {}", rig.name()),
        )),
    }
}

/// How a dance on a character is answered.
pub(crate) struct RigAnswer {
    format: RigFormat,
    mapping: String,
}

impl RigAnswer {
    pub(crate) fn of(character: &Character) -> Self {
        let mapping = serde_json::to_string(character.mapping()).unwrap_or_default();
        Self { format: character.format(), mapping: plain(&mapping) }
    }

    /// Extension of the file.
    pub(crate) fn extension(&self) -> &'static str {
        self.format.name()
    }

    /// Adds media type and mapping; a mapping of long names is left out.
    pub(crate) fn add_to(&self, headers: &mut HeaderMap) {
        let kind = HeaderValue::from_static(self.format.content_type());
        headers.insert(header::CONTENT_TYPE, kind);
        if self.mapping.len() <= LONGEST_MAPPING
            && let Ok(mapping) = HeaderValue::try_from(&self.mapping)
        {
            headers.insert(MAPPING, mapping);
        }
    }
}

/// JSON in plain ASCII.
fn plain(json: &str) -> String {
    let mut plain = String::with_capacity(json.len());
    for letter in json.chars() {
        match letter.is_ascii() && letter != '\u{7f}' {
            true => plain.push(letter),
            false => {
                for unit in letter.encode_utf16(&mut [0; 2]) {
                    plain.push_str(&format!("\\u{unit:04x}"));
                }
            }
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapping_in_a_header_is_ascii_and_the_same_json() {
        let json = "{\"hips\":\"腰 \u{1f483}\u{7f}\"}";
        let plain = plain(json);
        assert!(HeaderValue::try_from(&plain).is_ok());
        let [one, other]: [serde_json::Value; 2] =
            [json, &plain].map(|text| serde_json::from_str(text).unwrap());
        assert_eq!(one, other);
    }
}
