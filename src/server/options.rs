//! The options of a request: read from its query, shown in the OpenAPI document.

use axum::{extract::Query, http::Uri};
use utoipa::{
    IntoParams, PartialSchema, ToSchema,
    openapi::{
        RefOr, Required,
        path::{Parameter, ParameterBuilder, ParameterIn},
        schema::{
            AdditionalProperties, KnownFormat, Object, ObjectBuilder, Schema, SchemaFormat, Type,
        },
    },
};

use super::error::ServerError;
pub(crate) use crate::options::{
    RequestOptions, longest_value, option_named, option_names, shorten,
};
use crate::{
    engine::accepted_styles,
    options::{Accepts, OPTIONS, OptionSpec},
};

impl RequestOptions {
    /// Takes all options of a query string.
    ///
    /// # Errors
    /// [`ServerError::Option`] names the first option that is wrong, and what is accepted.
    pub(crate) fn from_query(uri: &Uri) -> Result<Self, ServerError> {
        let mut options = Self::default();
        let Query(pairs) =
            Query::<Vec<(String, String)>>::try_from_uri(uri).map_err(|rejection| {
                ServerError::Option { name: "query".to_owned(), problem: rejection.body_text() }
            })?;
        for (name, text) in pairs {
            options.set(&name, &text)?;
        }
        Ok(options)
    }
}

fn about(option: &OptionSpec) -> String {
    format!("{} Default: {}.", option.about, option.default)
}

fn parameters(options: impl Iterator<Item = &'static OptionSpec>) -> Vec<Parameter> {
    let parameter = |option: &OptionSpec| {
        ParameterBuilder::new()
            .name(option.name)
            .parameter_in(ParameterIn::Query)
            .required(Required::False)
            .description(Some(about(option)))
            .schema(Some(option.accepts.schema()))
            .build()
    };
    options.map(parameter).collect()
}

impl IntoParams for RequestOptions {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        parameters(OPTIONS.iter())
    }
}

/// The options that say how a result is written, as the OpenAPI document shows them.
pub(crate) struct OutputOptions;

impl IntoParams for OutputOptions {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        parameters(OPTIONS.iter().filter(|option| option.is_output()))
    }
}

/// One option, as `GET /info` shows it.
#[derive(Clone, Debug, serde::Serialize, ToSchema)]
pub(crate) struct OptionInfo {
    #[schema(example = "fps")]
    name: &'static str,
    #[schema(example = "Frames per second.")]
    description: &'static str,
    #[schema(example = "one of 20, 24, 30, 60")]
    accepts: String,
    #[schema(example = "60")]
    default: &'static str,
}

/// All options, as `GET /info` shows them for a model with these styles.
pub(crate) fn describe(styles: &[String]) -> Vec<OptionInfo> {
    let describe = |option: &OptionSpec| OptionInfo {
        name: option.name,
        description: option.about,
        accepts: match option.accepts {
            Accepts::Style => format!("one of {}", accepted_styles(styles).join(", ")),
            accepts => accepts.to_string(),
        },
        default: option.default,
    };
    OPTIONS.iter().map(describe).collect()
}

/// The bytes of an audio file, as the OpenAPI document shows them.
pub(crate) struct AudioFile;

impl PartialSchema for AudioFile {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new()
            .schema_type(Type::String)
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)))
            .description(Some(
                "The song: wav, aiff, flac, mp3, ogg, webm (vorbis, opus) or m4a (aac, alac).",
            ))
            .into()
    }
}

impl ToSchema for AudioFile {}

/// The parts of a form that are about a character of the caller's own.
fn rig_parts() -> [(&'static str, Object); 2] {
    let text = || ObjectBuilder::new().schema_type(Type::String);
    let file =
        text().format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary))).description(Some(
            "A character or skeleton of your own in its rest pose: bvh, glb or vrm. The dance \
             comes back as the same file, on its own bones; `POST /generate` only.",
        ));
    let mapping = text().description(Some(
        "JSON that says which bones of the rig are which parts of the body, as the header \
         `x-rig-mapping` tells it: `{\"bones\": {\"hips\": \"pelvis\"}}`. Parts that it does not \
         name are found by VRM's humanoid bones, by names, or by shape.",
    ));
    [("rig", file.build()), ("rig_mapping", mapping.build())]
}

/// The multipart form: the audio, which pose codes can stand in for, and any of the options, as the
/// OpenAPI document shows it.
pub(crate) struct GenerateForm;

impl PartialSchema for GenerateForm {
    fn schema() -> RefOr<Schema> {
        let form = ObjectBuilder::new()
            .property("file", AudioFile::schema())
            .additional_properties(Some(AdditionalProperties::<Schema>::FreeForm(false)));
        let with = |form: ObjectBuilder, option: &OptionSpec| {
            let mut schema = option.accepts.schema();
            schema.description = Some(about(option));
            form.property(option.name, schema)
        };
        let form = OPTIONS.iter().fold(form, with);
        let with_rig = |form: ObjectBuilder, (name, schema)| form.property(name, schema);
        rig_parts().into_iter().fold(form, with_rig).into()
    }
}

impl ToSchema for GenerateForm {}
