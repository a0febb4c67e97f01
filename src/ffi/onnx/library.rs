//! Search and loading of the ONNX Runtime library.

use std::env;
use std::ffi::CStr;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use ort::environment::Environment;
use ort::ep::{self, ExecutionProvider, ExecutionProviderDispatch};
use ort::logging::LogLevel;

use super::{MINIMUM_VERSION, OnnxError, Provider, RuntimeInfo};
use crate::ffi::environment;

const _: () = assert!(MINIMUM_VERSION == ort::MINOR_VERSION);

/// The library's file name on Linux.
const FILE_NAME: &str = "libonnxruntime.so";
/// Variable that disables the telemetry of ONNX Runtime.
///
/// Since 1.29 it reports its use on Linux unless this variable is set when it is loaded. `with_telemetry(false)` comes
/// too late: an event is already on its way.
const NO_TELEMETRY: (&CStr, &CStr) = (c"ORT_DISABLE_TELEMETRY", c"1");

/// Loaded runtime. It lives until the process ends, as the library cannot be unloaded safely.
pub(super) struct Runtime {
    pub(super) info: RuntimeInfo,
    pub(super) environment: Environment,
}

static RUNTIME: Mutex<Option<&'static Runtime>> = Mutex::new(None);

/// Finds and loads the runtime, which must support the provider.
///
/// # Errors
/// As [`probe`](super::probe).
pub(super) fn probe(provider: Provider) -> Result<RuntimeInfo, OnnxError> {
    let info = runtime()?.info.clone();
    execution_provider(provider)?;
    Ok(info)
}

/// Execution provider of ONNX Runtime; `None` for the CPU, which needs none.
///
/// # Errors
/// [`OnnxError::Provider`] if the loaded library was built without it.
pub(super) fn execution_provider(provider: Provider) -> Result<Option<ExecutionProviderDispatch>, OnnxError> {
    fn built_in<P: ExecutionProvider>() -> bool {
        P::is_available().unwrap_or(false)
    }
    let (is_built_in, dispatch) = match provider {
        Provider::Cpu | Provider::Rust => return Ok(None),
        Provider::Cuda => (built_in::<ep::CUDA>(), ep::CUDA::default().build()),
        Provider::Tensorrt => (built_in::<ep::TensorRT>(), ep::TensorRT::default().build()),
        Provider::Migraphx => (built_in::<ep::MIGraphX>(), ep::MIGraphX::default().build()),
        Provider::Openvino => (built_in::<ep::OpenVINO>(), ep::OpenVINO::default().build()),
        Provider::Xnnpack => (built_in::<ep::XNNPACK>(), ep::XNNPACK::default().build()),
        Provider::Acl => (built_in::<ep::ACL>(), ep::ACL::default().build()),
    };
    if is_built_in {
        return Ok(Some(dispatch.error_on_failure()));
    }
    let library = runtime()?.info.library.as_deref().unwrap_or(Path::new(FILE_NAME)).display();
    let reason = format!(
        "{library} was built without it; set TRACTRIX_ONNXRUNTIME to a library that has it, or give --provider cpu"
    );
    Err(OnnxError::Provider { provider, reason })
}

/// Returns true if a library exists at a searched path, without loading it.
///
/// Libraries of the system's loader do not count.
pub(super) fn is_in_place() -> bool {
    match named() {
        Some((_, named)) => named.exists(),
        None => candidates(env::current_exe().ok().as_deref())
            .iter()
            .any(|path| path.components().count() > 1 && path.exists()),
    }
}

/// First environment variable that names the library, and its value. `ORT_DYLIB_PATH` is `ort`'s own.
fn named() -> Option<(&'static str, PathBuf)> {
    let value = |name: &'static str| Some((name, PathBuf::from(env::var_os(name).filter(|value| !value.is_empty())?)));
    ["TRACTRIX_ONNXRUNTIME", "ORT_DYLIB_PATH"].into_iter().find_map(value)
}

/// Returns the runtime, loaded by the first successful call; after a failure, the next call retries.
pub(super) fn runtime() -> Result<&'static Runtime, OnnxError> {
    let mut slot = RUNTIME.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some(runtime) = *slot {
        return Ok(runtime);
    }
    let library = load()?;
    let runtime: &'static Runtime = Box::leak(Box::new(start(library)?));
    *slot = Some(runtime);
    Ok(runtime)
}

/// Loads the first usable library, which depends on the environment and the file system.
fn load() -> Result<PathBuf, OnnxError> {
    if let Some((variable, path)) = named() {
        return match try_load(&path) {
            Ok(()) => Ok(path),
            Err(reason) => Err(OnnxError::NamedRuntime { variable, reason }),
        };
    }
    let mut tried = Vec::new();
    for path in candidates(env::current_exe().ok().as_deref()) {
        if path.components().count() > 1 && !path.exists() {
            tried.push(format!("{} (file not found)", path.display()));
            continue;
        }
        match try_load(&path) {
            Ok(()) => return Ok(path),
            Err(reason) => tried.push(reason),
        }
    }
    Err(OnnxError::RuntimeNotFound { tried })
}

/// Candidate paths of the library, in order of preference.
///
/// The library may be next to the executable, where packages put it, or in `third_party` of the source tree whose
/// `target` holds the executable. The last candidate is its bare name, which the system's loader looks up.
fn candidates(executable: Option<&Path>) -> Vec<PathBuf> {
    // ort asks for the executable's folder when a path is relative, and would panic without one.
    let Some((executable, folder)) = executable.and_then(|path| Some((path, path.parent()?))) else {
        return Vec::new();
    };
    let mut found = ["", "../lib", "../lib/tractrix"].map(|place| folder.join(place).join(FILE_NAME)).to_vec();
    let in_tree = |root: PathBuf| root.join("third_party/onnxruntime").join(env::consts::ARCH).join(FILE_NAME);
    found.extend(environment::source_tree(executable).map(in_tree));
    found.push(PathBuf::from(FILE_NAME));
    found
}

/// Loads a library into the process, with its telemetry disabled; only the first successful load counts.
fn try_load(path: &Path) -> Result<(), String> {
    let (name, value) = NO_TELEMETRY;
    environment::set(name, value);
    let absolute = if path.components().count() > 1 {
        std::path::absolute(path).map_err(|e| format!("{} ({e})", path.display()))?
    } else {
        path.to_path_buf()
    };
    match ort::init_from(&absolute) {
        Ok(_) => Ok(()),
        Err(reason) => Err(format!("{} ({reason})", path.display())),
    }
}

/// Initializes the loaded library.
fn start(library: PathBuf) -> Result<Runtime, OnnxError> {
    let environment = match ort::init().with_name("tractrix").with_telemetry(false).build() {
        Ok(environment) => environment,
        Err(error) => return Err(OnnxError::Runtime { library, reason: error.to_string() }),
    };
    environment.set_log_level(LogLevel::Error);
    let version = named_version(ort::info()).or_else(|| symbol_version(&library));
    Ok(Runtime { info: RuntimeInfo { library: Some(library), version }, environment })
}

/// Version in the build information.
///
/// It reads `ORT Build Info: git-branch=rel-1.31.1, git-commit-id=..., ...` if it was built from a branch of that name.
fn named_version(build_info: &str) -> Option<String> {
    let branch = build_info.split("git-branch=").nth(1)?.split(',').next()?;
    leading_version(branch.trim_start_matches(|c: char| !c.is_ascii_digit()))
}

/// Version of the library's symbols, `VERS_1.31.1`; it is near the beginning of the file.
fn symbol_version(library: &Path) -> Option<String> {
    // Prefix of a version among the library's symbols.
    const MARK: &[u8] = b"VERS_";
    let mut head = Vec::new();
    File::open(library).ok()?.take(4 << 20).read_to_end(&mut head).ok()?;
    let versions = head.windows(MARK.len()).enumerate().filter(|(_, window)| *window == MARK);
    let after = |at: usize| String::from_utf8_lossy(&head[at..head.len().min(at + 32)]).into_owned();
    versions.map(|(at, _)| after(at + MARK.len())).find_map(|text| leading_version(&text))
}

/// Leading digits and dots of a text, if they form a version.
fn leading_version(text: &str) -> Option<String> {
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let version = text[..end].trim_end_matches('.');
    version.contains('.').then(|| version.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_is_read_from_the_branch_or_from_the_symbols() {
        let info = "ORT Build Info: git-branch=rel-1.31.1, git-commit-id=26250ae, build type=Release";
        assert_eq!(named_version(info).as_deref(), Some("1.31.1"));
        assert_eq!(named_version("ORT Build Info: git-branch=HEAD, git-commit-id=1, x"), None);
        let folder = tempfile::tempdir().unwrap();
        let library = folder.path().join("libonnxruntime.so");
        std::fs::write(&library, b"\x7fELF\0VERS_x\0OrtGetApiBase\0VERS_1.31.1\0more").unwrap();
        assert_eq!(symbol_version(&library).as_deref(), Some("1.31.1"));
        assert_eq!(symbol_version(&folder.path().join("none.so")), None);
    }

    #[test]
    fn the_library_is_searched_next_to_the_program_first_and_by_the_loader_last() {
        let found = candidates(Some(Path::new("/opt/tractrix/bin/tractrix")));
        assert_eq!(found.first(), Some(&PathBuf::from("/opt/tractrix/bin/libonnxruntime.so")));
        assert!(found.contains(&PathBuf::from("/opt/tractrix/bin/../lib/tractrix/libonnxruntime.so")), "{found:?}");
        assert_eq!(found.last(), Some(&PathBuf::from("libonnxruntime.so")));
        assert_eq!(found.len(), 4, "no folder above an installed program counts: {found:?}");
    }

    #[test]
    fn a_program_in_cargos_folder_uses_the_library_of_its_source_tree() {
        let tree = tempfile::tempdir().unwrap();
        std::fs::write(tree.path().join("Cargo.toml"), "").unwrap();
        let library = tree.path().join("third_party/onnxruntime").join(env::consts::ARCH).join(FILE_NAME);
        assert!(candidates(Some(&tree.path().join("target/release/deps/tests"))).contains(&library));
        for copied in ["tractrix", "bin/tractrix", "target/tractrix", "a/b/c/tractrix"] {
            let found = candidates(Some(&tree.path().join(copied)));
            assert!(!found.contains(&library), "{copied}: {found:?}");
        }
    }

    #[test]
    fn telemetry_is_off_before_a_library_is_loaded() {
        let (name, value) = NO_TELEMETRY;
        let _ = try_load(Path::new("/no/such/library.so"));
        assert_eq!(env::var(name.to_str().unwrap()).unwrap().as_bytes(), value.to_bytes());
    }

    #[test]
    fn a_file_that_is_no_library_is_rejected_with_its_path() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("libonnxruntime.so");
        std::fs::write(&path, "not a library").unwrap();
        let reason = try_load(&path).unwrap_err();
        assert!(reason.contains("libonnxruntime.so"), "{reason}");
        assert!(try_load(&folder.path().join("absent.so")).is_err());
    }
}
