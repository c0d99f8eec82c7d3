//! The options in the OpenAPI document.

use utoipa::{
    IntoParams, PartialSchema,
    openapi::{
        RefOr,
        path::{Parameter, ParameterBuilder, ParameterIn},
        schema::{KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type},
    },
};

use super::{RequestOptions, table::OPTIONS};

impl IntoParams for RequestOptions {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        OPTIONS
            .iter()
            .map(|option| {
                ParameterBuilder::new()
                    .name(option.name)
                    .parameter_in(ParameterIn::Query)
                    .required(utoipa::openapi::Required::False)
                    .description(Some(option.about))
                    .schema(Some(option.accepts.schema()))
                    .build()
            })
            .collect()
    }
}

/// The bytes of an audio file, as the OpenAPI document shows them.
pub(crate) struct AudioFile;

impl PartialSchema for AudioFile {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new()
            .schema_type(Type::String)
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)))
            .description(Some("The song: wav, flac, mp3, ogg/vorbis or m4a/aac."))
            .into()
    }
}

impl utoipa::ToSchema for AudioFile {}

/// The multipart form: the audio and any of the options, as the OpenAPI document shows it.
pub(crate) struct GenerateForm;

impl PartialSchema for GenerateForm {
    fn schema() -> RefOr<Schema> {
        let form = ObjectBuilder::new()
            .property("file", AudioFile::schema())
            .required("file")
            .additional_properties(Some(
                utoipa::openapi::schema::AdditionalProperties::<Schema>::FreeForm(false),
            ));
        OPTIONS
            .iter()
            .fold(form, |form, option| {
                let mut schema = option.accepts.schema();
                schema.description = Some(option.about.to_owned());
                form.property(option.name, schema)
            })
            .into()
    }
}

impl utoipa::ToSchema for GenerateForm {}
