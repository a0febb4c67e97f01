//! Tells the code its version, and which FFmpeg it is built for, as the bindings found out from the installed headers.

mod sources;

use std::env;
use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build");
    println!("cargo::rustc-check-cfg=cfg(ffmpeg_6_1)");
    if env::var_os("DEP_FFMPEG_FFMPEG_6_1").is_some() {
        println!("cargo::rustc-cfg=ffmpeg_6_1");
    }
    println!("cargo::rustc-env=TRACTRIX_VERSION={}", version());
}

/// Returns the package's version; in a build that is not a tagged release, followed by the hash of its sources.
fn version() -> String {
    println!("cargo::rerun-if-env-changed=TRACTRIX_RELEASE");
    let version = env::var("CARGO_PKG_VERSION").expect("cargo sets the version");
    if env::var_os("TRACTRIX_RELEASE").is_some_and(|release| release == "1") {
        return version;
    }
    let root = env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets the package's folder");
    for path in sources::PATHS {
        println!("cargo::rerun-if-changed={path}");
    }
    let hash = sources::hash(Path::new(&root)).expect("the package's sources can be read");
    format!("{version}+{hash}")
}
