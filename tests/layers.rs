//! The rooms of `src/` call one another as the table in `docs/architecture.md` says, and in no other way.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Room → rooms that it may call.
fn table() -> BTreeMap<String, BTreeSet<String>> {
    let text = fs::read_to_string(root().join("docs/architecture.md")).unwrap();
    let rows = text.lines().filter(|line| line.starts_with("| `"));
    let quoted = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').collect();
        (quoted(cells[0])[0].clone(), quoted(cells[2]).into_iter().collect())
    })
    .collect()
}

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// The code without comments and without what stands under `#[cfg(test)] mod tests`.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let production = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    production.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// Rooms named by `crate::room` or `use crate::{room, other::thing}`.
fn called(code: &str) -> BTreeSet<String> {
    let mut rooms = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        match rest.strip_prefix('{') {
            Some(list) => rooms.extend(first_level(list)),
            None => rooms.extend(first_name(rest)),
        }
    }
    rooms
}

fn first_name(text: &str) -> Option<String> {
    let name: String = text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    (!name.is_empty()).then_some(name)
}

/// The first name of every entry of a `{...}` list, whatever is nested in it.
fn first_level(list: &str) -> Vec<String> {
    let (mut depth, mut entry, mut names) = (0, String::new(), Vec::new());
    for c in list.chars() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => names.extend(first_name(std::mem::take(&mut entry).trim())),
            _ if depth == 0 => entry.push(c),
            _ => {}
        }
    }
    names.extend(first_name(entry.trim()));
    names
}

/// Files that are only compiled for tests although they are files of their own.
fn is_test_file(path: &Path) -> bool {
    matches!(path.file_stem().and_then(|s| s.to_str()), Some("tests" | "testing"))
}

#[test]
fn rooms_call_only_what_the_table_allows() {
    let table = table();
    assert!(table.len() >= 15, "the table in docs/architecture.md was not found: {table:?}");
    let mut wrong = Vec::new();
    for room in
        fs::read_dir(root().join("src")).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_dir())
    {
        let name = room.file_name().unwrap().to_str().unwrap().to_owned();
        let Some(allowed) = table.get(&name) else {
            wrong.push(format!("src/{name} is not in the table"));
            continue;
        };
        let mut files = Vec::new();
        rust_files(&room, &mut files);
        for file in files.iter().filter(|file| !is_test_file(file)) {
            for called in called(&code(file)) {
                if called != name && table.contains_key(&called) && !allowed.contains(&called) {
                    wrong.push(format!("{}: `{name}` may not call `{called}`", file.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn rooms_in_the_table_exist_and_it_has_no_cycles() {
    let table = table();
    let mut done: BTreeSet<&str> = BTreeSet::new();
    while done.len() < table.len() {
        let ready = table.iter().find(|(room, calls)| {
            !done.contains(room.as_str()) && calls.iter().all(|called| done.contains(called.as_str()))
        });
        let Some((room, _)) = ready else {
            panic!(
                "these rooms call one another in a circle: {:?}",
                table.keys().filter(|r| !done.contains(r.as_str()))
            );
        };
        assert!(root().join("src").join(room).is_dir(), "src/{room} does not exist");
        done.insert(room);
    }
}

#[test]
fn unsafe_code_stands_in_ffi_alone() {
    let mut files = Vec::new();
    rust_files(&root().join("src"), &mut files);
    let outside = files.iter().filter(|file| !file.starts_with(root().join("src/ffi")));
    let wrong: Vec<_> = outside.filter(|file| code(file).contains("allow(unsafe_code)")).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn lists_of_imports_are_understood() {
    let code = "use crate::{ground, sfm::{self, mapper::Options}, video};\nlet x = crate::io::colmap::read(p);";
    let expected = ["ground", "io", "sfm", "video"].map(str::to_owned);
    assert_eq!(called(code), BTreeSet::from(expected));
}
