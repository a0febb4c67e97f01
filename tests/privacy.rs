//! No connection, and no change outside the output folder: every command that a user may run unattended, with the
//! networks that come with the program, under strace and with empty folders for home, cache and temporary files.
//!
//! Where strace is missing, or the system forbids it to trace, the test says so and looks at those folders alone,
//! unless `TRACTRIX_REQUIRE_STRACE=1`: then it fails.

use std::fs;
use std::path::{Component, Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

/// Folders that programs write to without being asked, with the variables that name them.
const PERSONAL: [(&str, &str); 3] = [("HOME", "home"), ("TMPDIR", "tmp"), ("XDG_CACHE_HOME", "cache")];
/// Environment of the program: where programs, libraries, and its bundled networks are.
const KEPT: [&str; 4] = ["PATH", "LD_LIBRARY_PATH", "TRACTRIX_MODELS", "TRACTRIX_ONNXRUNTIME"];
/// Calls that read. A pair of sockets has no address: the handler of signals wakes a thread of its own process by it.
const HARMLESS: &str = "access chdir execve faccessat faccessat2 fstatfs getcwd getsockopt getxattr lgetxattr \
                        listxattr lstat newfstatat readlink readlinkat recvfrom recvmsg sendmsg sendto socketpair \
                        stat statfs statx";
/// Calls that change what they name.
const CHANGES: &str = "creat mkdir mkdirat rename renameat renameat2 rmdir unlink unlinkat";
/// A child of `batch` has it in the place of the terminal.
const NOWHERE: &str = "/dev/null";

struct Place {
    folder: TempDir,
    is_traced: bool,
}

impl Place {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        for name in PERSONAL.map(|(_, name)| name).into_iter().chain(["out", "log"]) {
            fs::create_dir(folder.path().join(name)).unwrap();
        }
        Self { folder, is_traced: can_trace() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs the program to its end; `name` is that of its logs.
    #[track_caller]
    fn run(&self, name: &str, arguments: &[&str]) {
        let program = env!("CARGO_BIN_EXE_tractrix");
        let mut command = Command::new(if self.is_traced { "strace" } else { program });
        if self.is_traced {
            command.args(["-ff", "--seccomp-bpf", "-qq", "-y", "-s", "4096", "-e", "signal=none"]);
            command.args(["-e", "trace=%file,%network", "-o"]).arg(self.path("log").join(name)).arg(program);
        }
        // ONNX Runtime reports nothing where it takes the machine for a build server: no variable of those may be here.
        command.env_clear().env("ORT_DISABLE_TELEMETRY", "0");
        command.envs(KEPT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
        command.envs(PERSONAL.map(|(variable, name)| (variable, self.path(name))));
        let output = command.args(arguments).output().expect("the program starts");
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    }

    /// The calls of all threads and children of all commands, with the name of the log.
    fn calls(&self) -> Vec<(String, String)> {
        let logs = fs::read_dir(self.path("log")).unwrap().map(|entry| entry.unwrap().path());
        let lines = logs.flat_map(|path| {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let text = String::from_utf8_lossy(&fs::read(&path).unwrap()).into_owned();
            text.lines().map(|line| (name.clone(), line.to_owned())).collect::<Vec<_>>()
        });
        lines.filter(|(_, line)| line.contains('(')).collect()
    }

    /// Whether a call reads, or changes what the program may change.
    fn is_allowed(&self, call: &str) -> bool {
        let (name, arguments) = call.split_once('(').unwrap();
        let is_open = matches!(name, "open" | "openat");
        let writes = ["O_WRONLY", "O_RDWR", "O_CREAT", "O_TRUNC"].iter().any(|flag| arguments.contains(flag));
        let is_one_of = |list: &str| list.split_whitespace().any(|known| known == name);
        is_one_of(HARMLESS)
            || is_open && !writes
            || (is_open || is_one_of(CHANGES)) && paths(call).iter().all(|path| self.is_ours(path))
    }

    fn is_ours(&self, path: &Path) -> bool {
        let is_plain = !path.components().any(|part| part == Component::ParentDir);
        path == Path::new(NOWHERE) || path.starts_with(self.path("out")) && is_plain
    }
}

/// Whether programs can be traced here.
fn can_trace() -> bool {
    let tried = Command::new("strace").args(["-f", "--seccomp-bpf", "-qq", "-o", NOWHERE, "true"]).output();
    let reason = match tried {
        Ok(tried) if tried.status.success() => return true,
        Ok(tried) => String::from_utf8_lossy(&tried.stderr).trim().to_owned(),
        Err(error) => error.to_string(),
    };
    let message = format!("strace: {reason}; install it, and allow ptrace (in a container: --cap-add=SYS_PTRACE)");
    assert!(std::env::var_os("TRACTRIX_REQUIRE_STRACE").is_none_or(|v| v != "1"), "{message}");
    eprintln!("skipped: {message}");
    false
}

/// All paths of a call as strace prints it: those that it names, from the folder that stands before each, and the one
/// that the descriptor which it returned leads to.
fn paths(call: &str) -> Vec<PathBuf> {
    let parts: Vec<&str> = call.split('"').collect();
    let named = parts.chunks_exact(2).map(|pair| {
        let folder = pair[0].trim_end_matches([',', ' ']).strip_suffix('>').and_then(|text| text.rsplit_once('<'));
        Path::new(folder.map_or("", |(_, folder)| folder)).join(pair[1])
    });
    let returned = call.rsplit_once(" = ").and_then(|(_, value)| Some(value.split_once('<')?.1.trim_end_matches('>')));
    named.chain(returned.map(PathBuf::from)).collect()
}

#[test]
fn nothing_is_sent_and_nothing_is_written_outside_the_output_folder() {
    let place = Place::new();
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("dataset/demo/video.mp4");
    let (list, results) = (place.path("list.txt"), place.path("out/run"));
    fs::write(&list, format!("{}\n", clip.display())).unwrap();
    let small = "--max-dimension 320 --threads 1 --set detector.input_size=320";
    let (clip, list, run) = (clip.to_str().unwrap(), list.to_str().unwrap(), results.to_str().unwrap());
    let command = |name: &str, before: &[&str], after: &str| {
        let mut arguments = vec![name];
        arguments.extend(before);
        arguments.extend(after.split_whitespace());
        place.run(name, &arguments);
    };
    command("doctor", &[], "");
    command("run", &[clip, "--output", run], &format!("--end 6f {small}"));
    command("sfm", &[clip, "--output", place.path("out/sfm").to_str().unwrap()], &format!("--end 6f {small}"));
    command("export", &[run], "--format all");
    let live = place.path("out/live");
    command("live", &[clip, "--output", live.to_str().unwrap()], &format!("--no-final-run {small}"));
    command("summary", &[run, "--output", place.path("out/all.csv").to_str().unwrap()], "");
    command(
        "batch",
        &[list, "--output", place.path("out/batch").to_str().unwrap()],
        &format!("--jobs 1 --end 3f {small}"),
    );

    for (variable, name) in PERSONAL {
        let left: Vec<_> = fs::read_dir(place.path(name)).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert!(left.is_empty(), "{variable} was empty, and now holds {left:?}");
    }
    if place.is_traced {
        let calls = place.calls();
        let forbidden: Vec<_> = calls.iter().filter(|(_, call)| !place.is_allowed(call)).collect();
        assert!(
            forbidden.is_empty(),
            "{} calls, the first: {:#?}",
            forbidden.len(),
            &forbidden[..forbidden.len().min(9)]
        );
        // The trace must show what it is taken for.
        assert!(
            calls.iter().any(|(of, call)| of == "live" && call.contains("live.jsonl")),
            "live is seen to write nothing"
        );
        for name in ["run", "sfm", "export", "summary", "batch"] {
            let of_command = |(of, call): &&(String, String)| of == name && call.starts_with("rename");
            assert!(calls.iter().any(|call| of_command(&call)), "{name} is seen to write nothing");
        }
        for name in ["doctor", "run", "batch"] {
            let loads = |(of, call): &(String, String)| of == name && call.contains("libonnxruntime.so");
            assert!(
                !tractrix::ffi::onnx::is_in_place(tractrix::ffi::onnx::Provider::Cpu) || calls.iter().any(loads),
                "{name} loads no ONNX Runtime"
            );
        }
    }
}

#[test]
fn live_opens_the_named_addresses_and_no_others() {
    let place = Place::new();
    if !place.is_traced {
        return;
    }
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("dataset/demo/video.mp4");
    let out = place.path("out/live");
    let fixed = ["live", clip.to_str().unwrap(), "--output", out.to_str().unwrap(), "--no-final-run"];
    let none = ["--detector", "none", "--mask-network", "none", "--max-dimension", "320"];
    let named = ["--cot", "udp:127.0.0.1:9", "--mavlink", "udp:127.0.0.1:10", "--page", "127.0.0.1:0"];
    place.run("live", &[&fixed[..], &none, &named].concat());
    let calls = place.calls();
    let of = |name: &str| {
        let wanted = calls.iter().filter(|(_, call)| call.starts_with(&format!("{name}(")));
        wanted.map(|(_, call)| call.as_str()).filter(|call| call.contains("AF_INET")).collect::<Vec<_>>()
    };
    let (opened, connected, bound) = (of("socket"), of("connect"), of("bind"));
    assert_eq!((opened.len(), connected.len(), bound.len()), (3, 2, 3), "{calls:#?}");
    let has = |calls: &[&str], port: &str, address: &str| {
        calls.iter().any(|call| call.contains(&format!("htons({port})")) && call.contains(&format!("\"{address}\"")))
    };
    assert!(has(&connected, "9", "127.0.0.1") && has(&connected, "10", "127.0.0.1"), "{connected:?}");
    // Two senders without an address of their own, and the page.
    assert_eq!(bound.iter().filter(|call| call.contains("\"0.0.0.0\"")).count(), 2, "{bound:?}");
    assert!(has(&bound, "0", "127.0.0.1"), "{bound:?}");
}

#[test]
fn calls_are_judged_by_what_they_change() {
    let place = Place { folder: TempDir::new().unwrap(), is_traced: false };
    let out = place.path("out");
    let out = out.to_str().unwrap();
    for call in [
        format!(r#"openat(AT_FDCWD</work>, "{out}/a", O_WRONLY|O_CREAT|O_EXCL|O_CLOEXEC, 0600) = 5<{out}/a>"#),
        format!(r#"renameat(7<{out}/run>, ".a", 7<{out}/run>, "a") = 0"#),
        r#"openat(AT_FDCWD</work>, "/etc/passwd", O_RDONLY|O_CLOEXEC) = 5</etc/passwd>"#.into(),
        r#"openat(AT_FDCWD</work>, "/dev/null", O_RDWR|O_CLOEXEC) = 5</dev/null>"#.into(),
        "socketpair(AF_UNIX, SOCK_STREAM|SOCK_CLOEXEC, 0, [3<socket:[1]>, 4<socket:[2]>]) = 0".into(),
    ] {
        assert!(place.is_allowed(&call), "{call}");
    }
    for call in [
        "socket(AF_UNIX, SOCK_STREAM|SOCK_CLOEXEC, 0) = 5<socket:[1]>".into(),
        "connect(5<socket:[1]>, {sa_family=AF_INET, sin_port=htons(53)}, 16) = 0".into(),
        r#"mkdir("/home/user/.cache/Microsoft", 0700) = -1 EEXIST (File exists)"#.into(),
        r#"linkat(11</home/user/.cache>, "new", 11</home/user/.cache>, "deviceid", 0) = 0"#.into(),
        format!(r#"openat(AT_FDCWD</work>, "{out}/link", O_WRONLY|O_TRUNC) = 5</home/user/thesis.tex>"#),
        format!(r#"unlinkat(AT_FDCWD</work>, "{out}/../thesis.tex", 0) = 0"#),
        format!(r#"rename("{out}/a", "/tmp/a") = 0"#),
        r#"creat("relative", 0600) = 5"#.into(),
    ] {
        assert!(!place.is_allowed(&call), "{call}");
    }
}

#[test]
fn a_copied_program_takes_nothing_from_folders_above_it_nor_from_where_it_was_built() {
    let folder = TempDir::new().unwrap();
    let (program, planted) = (folder.path().join("bin/tractrix"), folder.path().join("third_party/onnxruntime"));
    fs::create_dir(folder.path().join("bin")).unwrap();
    let built = env!("CARGO_BIN_EXE_tractrix");
    fs::hard_link(built, &program).or_else(|_| fs::copy(built, &program).map(drop)).unwrap();
    let networks = ["yolox_nano.onnx", "mobile_sam_encoder.onnx", "mobile_sam_decoder.onnx", "box_masks.onnx"];
    for file in networks.into_iter().chain(["libonnxruntime.so"]) {
        for place in [planted.join(std::env::consts::ARCH), folder.path().join("models")] {
            fs::create_dir_all(&place).unwrap();
            fs::write(place.join(file), "planted").unwrap();
        }
    }
    fs::write(folder.path().join("Cargo.toml"), "").unwrap();
    let mut command = Command::new(&program);
    command.arg("doctor").env_clear().envs(KEPT[..2].iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("ONNX Runtime") && said.contains("bundled network"), "{said}");
    let source_tree = Path::new(env!("CARGO_MANIFEST_DIR"));
    for place in [planted, folder.path().join("models"), source_tree.join("third_party"), source_tree.join("models")] {
        assert!(!said.contains(place.to_str().unwrap()), "{}: {said}", place.display());
    }
}
