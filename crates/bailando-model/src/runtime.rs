//! Finds and loads the ONNX Runtime shared library, once per process.

use std::{
    env::{self, consts},
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use ort::{LoadDynamicError, environment::Environment, logging::LogLevel};

use super::{ModelError, error::loader_reason, installed::python_library};

/// Environment variable that names the library file, ahead of every other place.
pub const LIBRARY_VARIABLE: &str = "ORT_DYLIB_PATH";

/// Folder of the project that `scripts/fetch-onnxruntime.sh` unpacks the library into.
const PROJECT_FOLDER: &str = ".onnxruntime/lib";

/// ONNX Runtime as it was loaded.
#[derive(Debug)]
pub(super) struct Runtime {
    pub(super) environment: Environment,
    /// The file, or a bare name where the system's loader found it.
    pub(super) library: PathBuf,
}

/// The process-wide ONNX Runtime; the library is loaded on first use.
pub(super) fn runtime() -> Result<&'static Runtime, ModelError> {
    static RUNTIME: OnceLock<Result<Runtime, String>> = OnceLock::new();
    RUNTIME.get_or_init(load).as_ref().map_err(|problem| ModelError::Runtime(problem.clone()))
}

fn load() -> Result<Runtime, String> {
    let library = find_library()?;
    // `init_from` first: ort's lazy path panics when the library is missing.
    let environment = ort::environment::init_from(&library)
        .map_err(|error| not_loaded(&library, &error))?
        .with_name("bailando")
        .with_telemetry(false)
        .with_logger(Arc::new(log))
        .build()
        .map_err(|e| e.to_string())?;
    Ok(Runtime { environment, library })
}

/// Says why the library was not loaded, and what to do where the system's loader, asked for the
/// bare name, has not found it either.
fn not_loaded(library: &Path, error: &LoadDynamicError) -> String {
    let LoadDynamicError::Dlopen { error, .. } = error else {
        return error.to_string();
    };
    let reason = loader_reason(error);
    match library == Path::new(&file_name()) {
        true => not_found(&reason),
        false => reason,
    }
}

fn not_found(reason: &str) -> String {
    format!(
        "{} was not found beside the executable, in {PROJECT_FOLDER} or in the system's library \
         folders ({reason}): run `make setup` (or scripts/fetch-onnxruntime.sh), or set \
         {LIBRARY_VARIABLE} to the file",
        file_name()
    )
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

fn file_name() -> String {
    format!("{}onnxruntime{}", consts::DLL_PREFIX, consts::DLL_SUFFIX)
}

/// Finds the library to load: the variable, else the first of [`places`], else that of a Python
/// environment around the executable, else the bare name, which the loader looks for in the
/// system's library folders.
fn find_library() -> Result<PathBuf, String> {
    if let Some(chosen) = env::var_os(LIBRARY_VARIABLE).map(PathBuf::from) {
        return match chosen.is_file() {
            true => Ok(chosen),
            false => Err(format!(
                "{LIBRARY_VARIABLE} is set to {}, which is not a file: correct it or unset it",
                chosen.display()
            )),
        };
    }
    let executable = env::current_exe().ok();
    let found = places(executable.as_deref(), env::current_dir().ok().as_deref())
        .into_iter()
        .find(|path| path.is_file());
    let in_python = || python_library(executable.as_deref()?, &file_name());
    match found.or_else(in_python) {
        Some(path) => Ok(path),
        // Where a bare name is to be loaded, ort looks beside the executable, and panics without.
        None if executable.is_none() => Err(not_found("the executable's folder is unknown")),
        None => Ok(file_name().into()),
    }
}

/// Lists the place beside the executable, then the project's folder in each folder that the
/// executable lies in and in the working directory. Folders around the working directory are left
/// out: anybody may put a library into `/tmp`.
fn places(executable: Option<&Path>, working_directory: Option<&Path>) -> Vec<PathBuf> {
    let folder = executable.and_then(Path::parent);
    let around = folder.into_iter().flat_map(Path::ancestors);
    let projects = around.chain(working_directory);
    let folders = projects.map(|project| project.join(PROJECT_FOLDER));
    let folders = folder.map(Path::to_path_buf).into_iter().chain(folders);
    folders.map(|folder| folder.join(file_name())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_library_is_looked_for_around_the_executable_but_not_around_the_working_directory() {
        let executable = Path::new("/project/target/release/bailando");
        let found = places(Some(executable), Some(Path::new("/tmp/songs")));
        let expected = [
            "/project/target/release",
            "/project/target/release/.onnxruntime/lib",
            "/project/target/.onnxruntime/lib",
            "/project/.onnxruntime/lib",
            "/.onnxruntime/lib",
            "/tmp/songs/.onnxruntime/lib",
        ];
        let expected = expected.map(|folder| Path::new(folder).join(file_name()));
        assert_eq!(found, expected);
    }
}
