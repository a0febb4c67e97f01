//! The rooms of `src/` call one another as the table in `docs/architecture.md` says, and in no other way.

#[path = "common/rust_source.rs"]
#[allow(dead_code)]
mod rust_source;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

use rust_source::{SourceFile, declared_modules, named_rooms, production, production_files, tokens};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Room → rooms that it may call.
fn table() -> BTreeMap<String, BTreeSet<String>> {
    let text = fs::read_to_string(root().join("docs/architecture.md")).unwrap();
    let section = text.split("\n## ").find(|section| section.starts_with("Modules")).unwrap_or_default();
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    let quoted = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').collect();
        (quoted(cells[0])[0].clone(), quoted(cells[2]).into_iter().collect())
    })
    .collect()
}

fn sources() -> Vec<SourceFile> {
    production_files(&root().join("src/lib.rs"))
}

/// What one file does against the table.
fn faults(file: &SourceFile, table: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let Some(room) = file.module.first() else { return Vec::new() };
    let Some(allowed) = table.get(room) else { return vec![format!("src/{room} is not in the table")] };
    let named = named_rooms(&file.tokens, &file.module);
    let foreign = named.iter().filter(|named| *named != room && (table.contains_key(*named) || *named == "*"));
    let wrong = foreign.filter(|named| !allowed.contains(*named));
    wrong.map(|named| format!("{}: `{room}` may not call `{named}`", file.path.display())).collect()
}

#[test]
fn rooms_call_only_what_the_table_allows() {
    let table = table();
    assert!(table.len() >= 15, "the table in docs/architecture.md was not found: {table:?}");
    let wrong: Vec<String> = sources().iter().flat_map(|file| faults(file, &table)).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_room_is_looked_into() {
    let modules: BTreeSet<String> = sources().iter().map(|file| file.module.join("::")).collect();
    let rooms = table().into_keys();
    let unseen: Vec<String> = rooms.filter(|room| !modules.contains(room)).collect();
    assert!(unseen.is_empty(), "{unseen:?}");
    assert!(
        modules.contains("mapper::incremental_mapper") && modules.contains("bundle::solver::sparse"),
        "{modules:?}"
    );
    assert!(!modules.contains("mapper::tests"), "test code is held to no table");
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
    let allows = |file: &SourceFile| file.tokens.windows(3).any(|w| w == ["allow", "(", "unsafe_code"]);
    let files = sources();
    let outside = files.iter().filter(|file| file.module.first().is_none_or(|room| room != "ffi"));
    let wrong: Vec<_> = outside.filter(|file| allows(file)).map(|file| &file.path).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// Files that open others by themselves: the kernel's own, those that were written a moment ago, and a library that is
/// run anyway.
const OPENERS: [&str; 8] = [
    "cli/doctor.rs",
    "cli/stop.rs",
    "export/annotate.rs",
    "ffi/onnx/library.rs",
    "io/atomic.rs",
    "files/mod.rs",
    "memory/mod.rs",
    "pipeline/driver/cost.rs",
];

#[test]
fn files_are_opened_through_one_module() {
    // Behind a name may be a pipe, a device, or more than memory holds.
    const OPENING: [[&str; 4]; 5] = [
        ["File", ":", ":", "open"],
        ["fs", ":", ":", "read"],
        ["fs", ":", ":", "read_to_string"],
        ["ImageReader", ":", ":", "open"],
        ["image", ":", ":", "open"],
    ];
    let opens = |file: &SourceFile| file.tokens.windows(4).any(|w| OPENING.iter().any(|o| w == o));
    let is_known = |file: &SourceFile| OPENERS.iter().any(|name| file.path.ends_with(name));
    let wrong: Vec<_> = sources().into_iter().filter(|f| opens(f) && !is_known(f)).map(|file| file.path).collect();
    assert!(wrong.is_empty(), "use crate::files: {wrong:?}");
}

/// What a module `sfm::mapper` with this text names.
fn named(text: &str) -> Vec<String> {
    let module = ["sfm", "mapper"].map(str::to_owned);
    named_rooms(&production(&tokens(text)), &module).into_iter().collect()
}

#[test]
fn paths_are_understood_in_every_form() {
    assert_eq!(named("use crate::{ground, sfm::{self, mapper::Options}, video};"), ["ground", "sfm", "video"]);
    assert_eq!(named("use {crate::ground::Plane, std::{fs, io}};"), ["ground"]);
    assert_eq!(named("let x = crate::io::colmap::read::<Model>(p)?; pub(crate) fn f() {}"), ["io"]);
    assert_eq!(named("use super::tracks::Track; use super::super::video::Source;"), ["sfm", "video"]);
    assert_eq!(named("use super::{Options, super::{video, cli::{run, args::Args}}};"), ["cli", "sfm", "video"]);
    assert_eq!(named("mod inner { use super::super::super::report; } use super::super::eval;"), ["eval", "report"]);
    assert_eq!(named("use crate as all; use crate::io as disk;"), ["*", "io"]);
    assert_eq!(named("use crate::*;"), ["*"]);
}

#[test]
fn comments_and_literals_name_nothing() {
    assert_eq!(named("// use crate::video;\n/// [`crate::cli`]\n/* crate::io /* crate::eval */ crate::io */"), [""; 0]);
    assert_eq!(named(r##"let a = "crate::video \" crate::io"; let b = r#"crate::"cli"#;"##), [""; 0]);
    assert_eq!(named("fn f<'a>(c: char) -> &'a str { if c == '\"' || c == '\\'' { crate::video::x() } }"), ["video"]);
}

#[test]
fn items_for_tests_alone_are_left_out_and_nothing_else() {
    let planted = "#[cfg(test)]\nmod tests;\n\nuse crate::video::Source;\n";
    assert_eq!(named(planted), ["video"]);
    let around = "use crate::io;\n#[cfg(test)]\n#[allow(dead_code)]\nmod tests {\n use crate::cli; fn f() { g() } }\n\
        fn after() { crate::eval::evaluate() }";
    assert_eq!(named(around), ["eval", "io"]);
    let function = "#[cfg(test)]\nfn f(a: [u8; 3]) -> u8 { crate::cli::g(a) }\nuse crate::ground;";
    assert_eq!(named(function), ["ground"]);
    assert_eq!(declared_modules(&production(&tokens("#[cfg(test)]\nmod tests;\npub mod map; mod inner {}"))), ["map"]);
}
