//! Flags of `bailando batch`.

use std::{num::NonZeroUsize, path::PathBuf};

use bailando::{formats::OutputFormat, model::Device, options::RequestOptions};

use crate::cli::console::at_least_one;

/// Make dances for a catalogue of songs; run again, it makes what is missing
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(in crate::cli) struct BatchArgs {
    /// Folders of songs, with their sub-folders, or songs
    #[arg(required = true)]
    pub(super) songs: Vec<PathBuf>,
    /// Folder for the results, in the same sub-folders and named after their songs
    #[arg(short, long, value_name = "DIR")]
    pub(super) out_dir: PathBuf,
    /// Format of the results
    #[arg(long, default_value = "bvh", value_parser = format)]
    pub(super) format: OutputFormat,
    /// Address of a server that makes the dances, such as http://127.0.0.1:8080 [default: this
    /// process makes them]
    #[arg(long, env = "BAILANDO_SERVER")]
    pub(super) server: Option<String>,
    /// Key of the server, where it asks for one
    #[arg(long, env = "BAILANDO_API_KEY", hide_env_values = true)]
    pub(super) api_key: Option<String>,
    /// Songs at the same time
    #[arg(long, default_value = "4", value_parser = at_least_one::<NonZeroUsize>)]
    pub(super) at_once: NonZeroUsize,
    /// Make results that are there once more
    #[arg(long)]
    pub(super) again: bool,
    /// File for the report: what was made, what failed and why [default: report.json in --out-dir]
    #[arg(long, value_name = "FILE")]
    pub(super) report: Option<PathBuf>,
    #[command(flatten)]
    pub(super) options: RequestOptions,
    /// Model directory, without --server
    #[arg(long, env = "BAILANDO_MODEL_DIR", default_value = "models/default")]
    pub(super) model_dir: PathBuf,
    /// What computes the model, without --server: cpu, cuda or cuda:N
    #[arg(long, env = "BAILANDO_DEVICE", default_value_t = Device::Cpu)]
    pub(super) device: Device,
    /// Threads that compute one step of the model, without --server [default: all cores]
    #[arg(long, env = "BAILANDO_THREADS", value_parser = at_least_one::<NonZeroUsize>)]
    pub(super) threads: Option<NonZeroUsize>,
}

impl BatchArgs {
    /// Format and options, as the query of an order.
    pub(super) fn query(&self) -> String {
        let mut query = format!("format={}", self.format.name());
        for (name, text) in self.options.given() {
            query.push_str(&format!("&{name}={}", percent_encoded(text)));
        }
        query
    }
}

fn percent_encoded(text: &str) -> String {
    let keep = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte);
    let encoded = |byte: u8| match keep(byte) {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    };
    text.bytes().map(encoded).collect()
}

fn format(name: &str) -> Result<OutputFormat, String> {
    let names = || OutputFormat::ALL.map(OutputFormat::name).join(", ");
    name.parse().map_err(|_| format!("expected one of {}", names()))
}
