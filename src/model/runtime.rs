//! Finds and loads the ONNX Runtime shared library, once per process.

use std::{
    env::{self, consts},
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use ort::{environment::Environment, logging::LogLevel};

use super::ModelError;

/// Environment variable that names the library file, ahead of every other place.
pub const LIBRARY_VARIABLE: &str = "ORT_DYLIB_PATH";

/// Folder of the project that `scripts/fetch-onnxruntime.sh` unpacks the library into.
const PROJECT_FOLDER: &str = ".onnxruntime/lib";

/// The process-wide ONNX Runtime environment; the library is loaded on first use.
pub(super) fn environment() -> Result<&'static Environment, ModelError> {
    static ENVIRONMENT: OnceLock<Result<Environment, String>> = OnceLock::new();
    ENVIRONMENT
        .get_or_init(load)
        .as_ref()
        .map_err(|problem| ModelError::Runtime(problem.clone()))
}

fn load() -> Result<Environment, String> {
    let library = find_library()?;
    // `init_from` first: ort's lazy path panics when the library is missing.
    ort::environment::init_from(&library)
        .map_err(|e| e.to_string())?
        .with_name("bailando")
        .with_telemetry(false)
        .with_logger(Arc::new(log))
        .build()
        .map_err(|e| e.to_string())
}

/// ONNX Runtime's own messages go where ours go. What it calls an error comes back to the caller
/// as one, so here it is detail.
fn log(level: LogLevel, _category: &str, _id: &str, _place: &str, message: &str) {
    match level {
        LogLevel::Fatal => tracing::error!(target: "onnxruntime", message),
        LogLevel::Error | LogLevel::Warning => tracing::debug!(target: "onnxruntime", message),
        LogLevel::Info | LogLevel::Verbose => tracing::trace!(target: "onnxruntime", message),
    }
}

/// The library to load: the variable, else beside the executable, else the project's folder (of
/// the executable's or the working directory's ancestors), else the system's.
fn find_library() -> Result<PathBuf, String> {
    let file = format!("{}onnxruntime{}", consts::DLL_PREFIX, consts::DLL_SUFFIX);
    if let Some(chosen) = env::var_os(LIBRARY_VARIABLE).map(PathBuf::from) {
        return match chosen.is_file() {
            true => Ok(chosen),
            false => Err(format!(
                "{LIBRARY_VARIABLE} is set to {}, which is not a file: correct it or unset it",
                chosen.display()
            )),
        };
    }
    let executable_folder = env::current_exe()
        .ok()
        .and_then(|path| path.parent().map(Path::to_path_buf));
    let beside = executable_folder.iter().map(|folder| folder.join(&file));
    let project = [env::current_dir().ok(), executable_folder.clone()];
    let project = project.iter().flatten().flat_map(|start| {
        start
            .ancestors()
            .map(|folder| folder.join(PROJECT_FOLDER).join(&file))
            .collect::<Vec<_>>()
    });
    let system = ["/usr/local/lib", "/usr/lib"]
        .iter()
        .map(|folder| Path::new(folder).join(&file));
    beside.chain(project).chain(system).find(|path| path.is_file()).ok_or_else(|| {
        format!(
            "{file} was not found beside the executable, in {PROJECT_FOLDER} or in the system's \
             library folders: run `make setup` (or scripts/fetch-onnxruntime.sh), or set \
             {LIBRARY_VARIABLE} to the file"
        )
    })
}
