//! Where the files of an installed program lie: an archive that was unpacked somewhere, a checkout,
//! or a Python environment (`pip install` puts the program into `bin` and its data into `share`).

use std::{
    env, fs,
    path::{Path, PathBuf},
};

/// Folder of data files, beside the folder of programs.
const SHARE: &str = "share/bailando";

/// Returns the model directory that `root` names: where it is relative and not in the working
/// directory, the one of that name around the executable.
pub(super) fn model_directory(root: &Path) -> PathBuf {
    let is_model = |folder: &PathBuf| folder.join("manifest.json").is_file();
    if root.is_absolute() || is_model(&root.to_owned()) {
        return root.to_owned();
    }
    let executable = env::current_exe().unwrap_or_default();
    let found = models(&executable, root).into_iter().find(is_model);
    found.unwrap_or_else(|| root.to_owned())
}

/// Lists the places of a model around the executable, the nearest first.
fn models(executable: &Path, root: &Path) -> Vec<PathBuf> {
    let around = executable.ancestors().skip(1).map(|folder| folder.join(root));
    let shared = executable.ancestors().nth(2).map(|prefix| prefix.join(SHARE).join(root));
    shared.into_iter().chain(around).collect()
}

/// Returns the library that the package `onnxruntime` of the executable's Python environment holds;
/// its name ends with its version.
pub(super) fn python_library(executable: &Path, name: &str) -> Option<PathBuf> {
    let pythons = entries(&executable.ancestors().nth(2)?.join("lib"));
    let pythons = pythons.filter(|path| file_name(path).starts_with("python3"));
    let folders = pythons.map(|python| python.join("site-packages/onnxruntime/capi"));
    let mut files = folders.flat_map(|folder| entries(&folder));
    files.find(|path| file_name(path).starts_with(name) && path.is_file())
}

fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries.filter_map(|entry| Some(entry.ok()?.path()))
}

fn file_name(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_looked_for_in_share_and_around_the_executable() {
        let found = models("/venv/bin/bailando".as_ref(), "models/default".as_ref());
        let expected = ["/venv/share/bailando", "/venv/bin", "/venv", "/"];
        assert_eq!(found, expected.map(|folder| Path::new(folder).join("models/default")));
    }

    #[test]
    fn a_python_environment_has_its_library_under_a_version() {
        let environment = tempfile::tempdir().unwrap();
        let capi = environment.path().join("lib/python3.12/site-packages/onnxruntime/capi");
        let executable = environment.path().join("bin/bailando");
        assert_eq!(python_library(&executable, "libonnxruntime.so"), None);
        fs::create_dir_all(&capi).unwrap();
        for name in ["onnxruntime_pybind11_state.so", "libonnxruntime.so.1.32.0"] {
            fs::write(capi.join(name), "").unwrap();
        }
        let found = python_library(&executable, "libonnxruntime.so");
        assert_eq!(found, Some(capi.join("libonnxruntime.so.1.32.0")));
    }
}
