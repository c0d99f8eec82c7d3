//! The CUDA execution provider of ONNX Runtime, and what it needs to be loaded.

use std::{
    path::{Path, PathBuf},
    sync::OnceLock,
};

use ort::{
    ep::{
        self, ArenaExtendStrategy, ExecutionProvider,
        cuda::{CUDA_DYLIBS, CUDNN_DYLIBS, ConvAlgorithmSearch},
    },
    session::builder::SessionBuilder,
    util::preload_dylib,
};

use super::{
    Device, ModelError,
    error::{loader_reason, one_line},
    runtime,
};

/// Puts the CUDA provider ahead of whatever `builder` gets later.
///
/// # Errors
/// [`ModelError::Device`] where the library has no such provider, or it cannot be used.
pub(super) fn register(
    builder: &mut SessionBuilder,
    index: u16,
    library: &Path,
) -> Result<(), ModelError> {
    let device = Device::Cuda { index };
    let refused = |problem| ModelError::Device { device: device.to_string(), problem };
    match ep::CUDA::is_available() {
        Ok(true) => {}
        Ok(false) => return Err(refused(no_provider(library))),
        Err(error) => return Err(refused(one_line(&error))),
    }
    preload(library).map_err(refused)?;
    let provider = ep::CUDA::default()
        .with_device_id(index.into())
        // The default doubles what was taken before: a GPU may be shared.
        .with_arena_extend_strategy(ArenaExtendStrategy::SameAsRequested)
        // The default tries every algorithm for every shape, and chunks have many shapes.
        .with_conv_algorithm_search(ConvAlgorithmSearch::Heuristic)
        // TensorFloat-32 has 10 bits of mantissa, and codes would differ.
        .with_tf32(false);
    provider.register(builder).map_err(|error| refused(explain(&one_line(&error))))
}

fn no_provider(library: &Path) -> String {
    format!(
        "{} was built without CUDA: run \
         `scripts/fetch-onnxruntime.sh --cuda` and set {} to the library that it names, or use \
         --device cpu",
        library.display(),
        runtime::LIBRARY_VARIABLE
    )
}

/// Loads the CUDA libraries that lie beside that of ONNX Runtime, so that no `LD_LIBRARY_PATH` is
/// needed. Others are left to the system's loader.
fn preload(library: &Path) -> Result<(), String> {
    static PRELOADED: OnceLock<Result<(), String>> = OnceLock::new();
    let load = || {
        beside(library).iter().try_for_each(|path| {
            preload_dylib(path).map_err(|error| explain(&loader_reason(&error)))
        })
    };
    PRELOADED.get_or_init(load).clone()
}

/// CUDA libraries in the folder of `library`, each after those that it needs. A bare name has no
/// folder: the working directory is none of ours.
fn beside(library: &Path) -> Vec<PathBuf> {
    let folder = library.parent().filter(|folder| !folder.as_os_str().is_empty());
    // cuDNN finds its own parts beside its first.
    let names = CUDA_DYLIBS.iter().chain(CUDNN_DYLIBS.iter().take(1));
    let paths = folder.into_iter().flat_map(|folder| names.clone().map(|name| folder.join(name)));
    paths.filter(|path| path.is_file()).collect()
}

/// Says what is missing before the loader's or ONNX Runtime's own words, where they show it.
fn explain(problem: &str) -> String {
    // Before it stands a place in the sources of ONNX Runtime.
    let problem = problem.split_once(" with error: ").map_or(problem, |(_, own)| own);
    let missing = [
        ("libcuda.so.1", "no NVIDIA driver was found"),
        ("libcudnn", "cuDNN 9 was not found"),
        ("libcu", "the libraries of CUDA 13 were not found"),
        ("no CUDA-capable device", "no GPU was found"),
        ("invalid device ordinal", "there is no GPU of this number"),
        ("driver version is insufficient", "the NVIDIA driver is older than CUDA 13 needs"),
    ];
    match missing.iter().find(|(sign, _)| problem.contains(sign)) {
        Some((_, meaning)) => format!("{meaning} ({problem})"),
        None => problem.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_said_first() {
        let loading = "libcuda.so.1: cannot open shared object file: No such file or directory";
        assert_eq!(explain(loading), format!("no NVIDIA driver was found ({loading})"));
        let in_runtime =
            format!("/x/bridge.cc:1 Get() Failed to load library /y with error: {loading}");
        assert_eq!(explain(&in_runtime), explain(loading));
        let cudnn = "libcudnn.so.9: cannot open shared object file";
        assert_eq!(explain(cudnn), format!("cuDNN 9 was not found ({cudnn})"));
        let blas = "libcublasLt.so.13: cannot open shared object file";
        let said = format!("the libraries of CUDA 13 were not found ({blas})");
        assert_eq!(explain(blas), said);
        assert_eq!(explain("out of memory"), "out of memory");
    }

    #[test]
    fn cuda_is_taken_from_the_librarys_folder_and_from_no_working_directory() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["libcudnn.so.9", "libcublas.so.13", "libcudart.so.13", "libother.so"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let found = beside(&folder.path().join("libonnxruntime.so"));
        let expected = ["libcudart.so.13", "libcublas.so.13", "libcudnn.so.9"];
        assert_eq!(found, expected.map(|name| folder.path().join(name)));
        assert_eq!(beside(Path::new("libonnxruntime.so")), Vec::<PathBuf>::new());
    }
}
