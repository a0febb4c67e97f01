use std::collections::BTreeMap;
use std::os::unix::fs::symlink;

use super::*;

/// A folder of results with `results/` and `page.html`.
fn place(relative: &Path) -> PathRole {
    let parts: Vec<_> = relative.iter().filter_map(|part| part.to_str()).collect();
    match parts[..] {
        [] | ["results"] => PathRole::Folder,
        [STATE, ..] => PathRole::State,
        ["page.html"] | ["results", "a" | "b" | "c"] => PathRole::File,
        _ => PathRole::Elsewhere,
    }
}

fn open(path: &Path) -> Result<OwnedFolder, FolderError> {
    OwnedFolder::open(path, "the test", place)
}

fn results(folder: &OwnedFolder, names: &[&str]) -> Result<(), FolderError> {
    folder.put_folder(Path::new("results"), |fresh| {
        names.iter().try_for_each(|name| Ok::<_, FolderError>(atomic::write(&fresh.join(name), name.as_bytes())?))
    })
}

fn page(folder: &OwnedFolder, text: &str) -> Result<(), FolderError> {
    folder.put_file(Path::new("page.html"), |fresh| Ok::<_, FolderError>(atomic::write(fresh, text.as_bytes())?))
}

/// Every file and link with its content, except the program's own state.
fn snapshot(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let outside_state = |file: &PathBuf| !file.starts_with(STATE);
    let content = |file: PathBuf| {
        let path = root.join(&file);
        let bytes = fs::read_link(&path)
            .map_or_else(|_| fs::read(&path).unwrap(), |to| to.into_os_string().into_encoded_bytes());
        (file, bytes)
    };
    files_below(root).unwrap().into_iter().filter(outside_state).map(content).collect()
}

fn names(root: &Path) -> Vec<String> {
    snapshot(root).keys().map(|path| path.display().to_string()).collect()
}

#[test]
fn a_folder_is_accepted_if_it_is_new_empty_or_its_own() {
    let place = tempfile::tempdir().unwrap();
    for path in [place.path().join("new"), place.path().to_owned()] {
        page(&open(&path).unwrap(), "one").unwrap();
        page(&open(&path).unwrap(), "two").unwrap();
        assert_eq!(fs::read(path.join("page.html")).unwrap(), b"two");
        fs::remove_dir_all(place.path()).unwrap();
        fs::create_dir(place.path()).unwrap();
    }
}

#[test]
fn a_foreign_folder_is_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in [("thesis.tex", "x"), ("results/a", "mine"), (".tractrix/notes", "mine")] {
        let root = folder.path().join("one");
        atomic::write(&root.join(name), content.as_bytes()).unwrap();
        let before = files_below(&root).unwrap();
        let error = open(&root).unwrap_err();
        assert!(matches!(error, FolderError::NotOwn { .. }) && error.is_wrong_use(), "{error}");
        assert!(error.to_string().contains("--output"), "{error}");
        assert_eq!(files_below(&root).unwrap(), before);
        fs::remove_dir_all(root).unwrap();
    }
    // A folder of another command is not its own either.
    OwnedFolder::open(&folder.path().join("other"), "another", place).unwrap();
    atomic::write(&folder.path().join("other/page.html"), b"x").unwrap();
    assert!(matches!(open(&folder.path().join("other")), Err(FolderError::NotOwn { .. })));
}

#[test]
fn a_process_killed_at_its_start_leaves_no_foreign_folder() {
    let folder = tempfile::tempdir().unwrap();
    atomic::write(&folder.path().join(".tractrix/lock"), b"").unwrap();
    assert!(open(folder.path()).is_ok());
}

#[test]
fn foreign_files_are_kept_next_to_replaced_results() {
    let folder = tempfile::tempdir().unwrap();
    let owned = open(folder.path()).unwrap();
    results(&owned, &["a", "b"]).unwrap();
    let theirs = ["results/notes.txt", "results/deep/er/car.obj", "thesis.tex"];
    for name in theirs {
        atomic::write(&folder.path().join(name), b"theirs").unwrap();
    }
    symlink("/nowhere", folder.path().join("results/link")).unwrap();
    results(&owned, &["b", "c"]).unwrap();
    let found = names(folder.path());
    assert_eq!(
        found,
        ["results/b", "results/c", "results/deep/er/car.obj", "results/link", "results/notes.txt", "thesis.tex"]
    );
    owned.remove(Path::new("results")).unwrap();
    assert_eq!(names(folder.path()), ["results/deep/er/car.obj", "results/link", "results/notes.txt", "thesis.tex"]);
    for name in theirs {
        assert_eq!(fs::read(folder.path().join(name)).unwrap(), b"theirs");
    }
}

#[test]
fn foreign_files_in_places_of_results_are_refused_and_named() {
    let folder = tempfile::tempdir().unwrap();
    drop(open(folder.path()).unwrap());
    for name in ["page.html", "results/b", "results/a/inside"] {
        atomic::write(&folder.path().join(name), b"theirs").unwrap();
        let before = snapshot(folder.path());
        let error = open(folder.path()).unwrap_err();
        assert!(matches!(error, FolderError::InTheWay { .. }) && error.is_wrong_use(), "{error}");
        assert!(error.to_string().contains(name.trim_end_matches("/inside")), "{error}");
        assert_eq!(snapshot(folder.path()), before);
        fs::remove_dir_all(folder.path().join("results")).ok();
        fs::remove_file(folder.path().join("page.html")).ok();
    }
    // Also while the program is running.
    let owned = open(folder.path()).unwrap();
    atomic::write(&folder.path().join("results/b"), b"theirs").unwrap();
    let before = snapshot(folder.path());
    assert!(matches!(results(&owned, &["a", "b"]), Err(FolderError::InTheWay { .. })));
    assert_eq!(snapshot(folder.path()), before);
}

#[test]
fn a_file_that_is_no_longer_its_own_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    page(&open(folder.path()).unwrap(), "ours").unwrap();
    fs::remove_file(folder.path().join("page.html")).unwrap();
    drop(open(folder.path()).unwrap());
    fs::write(folder.path().join("page.html"), b"theirs").unwrap();
    assert!(matches!(open(folder.path()), Err(FolderError::InTheWay { .. })));
}

#[test]
fn links_are_never_followed() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    atomic::write(&elsewhere.path().join("precious"), b"precious").unwrap();
    let untouched = snapshot(elsewhere.path());
    let plant = |link: &str, to: &Path| {
        let link = folder.path().join(link);
        if link.is_dir() {
            fs::remove_dir_all(&link).unwrap();
        } else {
            fs::remove_file(&link).ok();
        }
        symlink(to, link).unwrap();
    };
    let precious = elsewhere.path().join("precious");
    for (link, to) in [
        ("results", elsewhere.path()),
        ("page.html", &precious),
        (".tractrix/lock", &precious),
        (".tractrix/manifest.json", &precious),
        (".tractrix/tmp", elsewhere.path()),
        (".tractrix", elsewhere.path()),
    ] {
        drop(open(folder.path()).unwrap());
        plant(link, to);
        let error = open(folder.path()).unwrap_err();
        assert!(matches!(error, FolderError::Link { .. }) && error.is_wrong_use(), "{link}: {error}");
        assert_eq!(snapshot(elsewhere.path()), untouched, "{link}");
        fs::remove_file(folder.path().join(link)).unwrap();
        fs::remove_dir_all(folder.path()).unwrap();
        fs::create_dir(folder.path()).unwrap();
    }
    // Created while the program is running.
    let owned = open(folder.path()).unwrap();
    plant("sequence", elsewhere.path());
    assert!(matches!(owned.subfolder("sequence"), Err(FolderError::Link { .. })));
    assert!(owned.subfolder("../sequence").is_err());
    assert_eq!(owned.subfolder("other").unwrap(), owned.root().join("other"));
    results(&owned, &["a"]).unwrap();
    plant("results", elsewhere.path());
    assert!(matches!(results(&owned, &["b"]), Err(FolderError::Link { .. })));
    assert!(matches!(owned.remove(Path::new("results")), Err(FolderError::Link { .. })));
    // Its own file by name, a foreign file behind the link.
    atomic::write(&elsewhere.path().join("a"), b"precious").unwrap();
    let untouched = snapshot(elsewhere.path());
    let another = InputIdentity { path: "two.mp4".into(), content: "two".into() };
    owned.claim(InputIdentity { path: "one.mp4".into(), content: "one".into() }, false).unwrap();
    assert!(matches!(owned.claim(another, true), Err(FolderError::Link { .. })));
    plant("page.html", &precious);
    assert!(matches!(page(&owned, "ours"), Err(FolderError::Link { .. })));
    assert_eq!(snapshot(elsewhere.path()), untouched);
}

#[test]
fn a_manifest_that_names_files_outside_is_ignored() {
    let place = tempfile::tempdir().unwrap();
    let (folder, precious) = (place.path().join("out"), place.path().join("precious"));
    atomic::write(&precious, b"precious").unwrap();
    page(&open(&folder).unwrap(), "ours").unwrap();
    let manifest = folder.join(STATE).join(MANIFEST);
    let text = fs::read_to_string(&manifest).unwrap();
    for planted in ["../precious", precious.to_str().unwrap()] {
        fs::write(&manifest, text.replace("page.html", planted)).unwrap();
        assert!(matches!(open(&folder), Err(FolderError::NotOwn { .. })), "{planted}");
        assert_eq!(fs::read(&precious).unwrap(), b"precious");
    }
}

#[test]
fn the_folder_itself_may_be_named_by_a_link() {
    let place = tempfile::tempdir().unwrap();
    let (real, link) = (place.path().join("real"), place.path().join("link"));
    fs::create_dir(&real).unwrap();
    symlink(&real, &link).unwrap();
    page(&open(&link).unwrap(), "ours").unwrap();
    assert_eq!(names(&real), ["page.html"]);
    fs::remove_dir_all(&real).unwrap();
    assert!(matches!(open(&link), Err(FolderError::Link { .. })), "a link to nowhere is no new folder");
}

#[test]
fn results_of_another_input_are_kept_without_overwrite() {
    let folder = tempfile::tempdir().unwrap();
    let input = |name: &str| InputIdentity { path: name.into(), content: name.into() };
    let owned = open(folder.path()).unwrap();
    owned.claim(input("one.mp4"), false).unwrap();
    results(&owned, &["a"]).unwrap();
    atomic::write(&folder.path().join("results/notes"), b"theirs").unwrap();
    drop(owned);
    let owned = open(folder.path()).unwrap();
    owned.claim(InputIdentity { path: "copy.mp4".into(), ..input("one.mp4") }, false).unwrap();
    let error = owned.claim(input("two.mp4"), false).unwrap_err();
    assert!(error.is_wrong_use() && error.to_string().contains("--overwrite"), "{error}");
    assert_eq!(names(folder.path()), ["results/a", "results/notes"]);
    owned.claim(input("two.mp4"), true).unwrap();
    assert_eq!(names(folder.path()), ["results/notes"]);
    assert_eq!(owned.input(), Some(input("two.mp4")));
}

#[test]
fn inputs_in_the_places_of_results_are_refused() {
    let place_of_test = tempfile::tempdir().unwrap();
    let (out, outside) = (place_of_test.path().join("out"), place_of_test.path().join("outside"));
    results(&open(&out).unwrap(), &["a"]).unwrap();
    for folder in [outside.clone(), out.join("videos"), outside.join("linked"), outside.join("plain")] {
        fs::create_dir_all(folder).unwrap();
    }
    atomic::write(&out.join("videos/v.mp4"), b"x").unwrap();
    atomic::write(&outside.join("plain/v.mp4"), b"x").unwrap();
    symlink(out.join("results"), outside.join("way")).unwrap();
    symlink(out.join("results/a"), outside.join("linked/a")).unwrap();
    let refused = |input: &Path| refuse_own_input(&out, place, "--masks", input).is_err();
    for input in [
        out.clone(),
        out.join("results"),
        out.join("results/a"),
        out.join("videos/../results"),
        outside.join("way"),
        outside.join("way/a"),
        outside.join("linked"),
        out.join(".tractrix"),
    ] {
        assert!(refused(&input), "{}", input.display());
    }
    for input in [out.join("videos"), out.join("videos/v.mp4"), outside.join("plain"), outside.join("none")] {
        assert!(!refused(&input), "{}", input.display());
    }
    let error = refuse_own_input(&out, place, "--masks", &out.join("results")).unwrap_err();
    assert!(error.is_wrong_use() && error.to_string().starts_with("--masks "), "{error}");
}

#[test]
fn a_failed_result_leaves_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let owned = open(folder.path()).unwrap();
    results(&owned, &["a"]).unwrap();
    let failed = owned.put_folder(Path::new("results"), |fresh| {
        atomic::write(&fresh.join("b"), b"half")?;
        Err::<(), FolderError>(IoError::content(fresh, "the cable came off").into())
    });
    assert!(failed.is_err_and(|error| error.to_string().contains("the cable came off")));
    assert_eq!(names(folder.path()), ["results/a"]);
    assert!(matches!(open(folder.path()), Err(FolderError::Busy { .. })));
}

#[test]
fn a_pipe_in_the_place_of_the_lock_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    page(&open(folder.path()).unwrap(), "ours").unwrap();
    let lock = folder.path().join(".tractrix/lock");
    fs::remove_file(&lock).unwrap();
    rustix::fs::mknodat(rustix::fs::CWD, &lock, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
    assert!(!OwnedFolder::is_busy(folder.path()));
    let error = open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("lock") && error.contains("a pipe"), "{error}");
}

#[test]
fn a_forged_manifest_removes_no_foreign_files() {
    let folder = tempfile::tempdir().unwrap();
    let input = |name: &str| InputIdentity { path: name.into(), content: name.into() };
    let owned = open(folder.path()).unwrap();
    owned.claim(input("one.mp4"), false).unwrap();
    results(&owned, &["a"]).unwrap();
    drop(owned);
    let theirs = ["thesis.tex", "results/notes", "deep/er/car.obj"];
    theirs.iter().for_each(|name| atomic::write(&folder.path().join(name), b"theirs").unwrap());
    let path = folder.path().join(".tractrix/manifest.json");
    let mut manifest: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let listed = manifest["files"].as_array_mut().unwrap();
    listed.extend(theirs.into_iter().chain(["", "results", ".tractrix/manifest.json"]).map(Into::into));
    fs::write(&path, manifest.to_string()).unwrap();
    open(folder.path()).unwrap().claim(input("two.mp4"), true).unwrap();
    assert_eq!(names(folder.path()), ["deep/er/car.obj", "results/notes", "thesis.tex"]);
}

#[test]
fn single_files_are_not_written_among_results() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    drop(OwnedFolder::open(&run, RunFolder::MADE_BY, RunFolder::place).unwrap());
    symlink(&run, place.path().join("link")).unwrap();
    for name in ["run/background/cameras.bin", "run/run.json", "link/export/vehicles.csv", "run/../run/objects/3"] {
        let error = refuse_place_of_results(&place.path().join(name)).unwrap_err();
        assert!(error.is_wrong_use() && error.to_string().contains("results"), "{name}: {error}");
    }
    for name in ["run/points.ply", "run/mine/background/cameras.bin", "background/cameras.bin", "other/run.json"] {
        assert!(refuse_place_of_results(&place.path().join(name)).is_ok(), "{name}");
    }
}
