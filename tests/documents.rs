//! What the documents promise of files is true: those that are named exist, links lead somewhere, and every dependency
//! has its reason. And no line of these rooms is wider than the code, comments and strings included.

use std::fs;
use std::path::{Path, PathBuf};

/// `max_width` of `rustfmt.toml`, which wraps neither comments nor strings.
const MAX_COLUMNS: usize = 120;
/// Where that is held.
const WRAPPED: [&str; 3] = ["src", "tests", "examples"];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// All files below a folder, or the file itself, that are text and no data.
fn texts(path: &Path, found: &mut Vec<PathBuf>) {
    if path.is_dir() {
        let mut entries: Vec<PathBuf> = fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()).collect();
        entries.sort();
        entries.iter().for_each(|entry| texts(entry, found));
    } else if fs::metadata(path).is_ok_and(|m| m.len() < 1 << 20) && fs::read_to_string(path).is_ok() {
        found.push(path.to_owned());
    }
}

fn texts_of(names: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    names.iter().for_each(|name| texts(&root().join(name), &mut found));
    found
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap()
}

fn shown(path: &Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).display().to_string()
}

/// Every document below `docs/` that a text names by its path from the root.
fn named_documents(text: &str) -> Vec<String> {
    let is_path = |c: &char| c.is_ascii_alphanumeric() || "/._-".contains(*c);
    let path = |(at, _)| {
        let path: String = text[at..].chars().take_while(is_path).collect();
        path.find(".md").map(|end| path[..end + ".md".len()].to_owned())
    };
    text.match_indices("docs/").filter_map(path).collect()
}

/// The targets of all links and pictures of a Markdown text, without those into the network.
fn links(markdown: &str) -> Vec<String> {
    let target = |(at, _)| markdown[at + "](".len()..].split(')').next().map(str::to_owned);
    let is_local = |target: &String| !target.contains("://") && !target.starts_with("mailto:");
    markdown.match_indices("](").filter_map(target).filter(is_local).collect()
}

/// What a heading is called in links: lower case, blanks as hyphens, without punctuation.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = text.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Why a link of a document leads nowhere.
fn broken(document: &Path, link: &str) -> Option<String> {
    let (path, fragment) = link.split_once('#').unwrap_or((link, ""));
    let target = match path {
        "" => document.to_owned(),
        path => document.parent().unwrap().join(path),
    };
    if !target.exists() {
        return Some(format!("{}: {link} is not there", shown(document)));
    }
    let has_heading = || read(&target).lines().any(|l| l.starts_with('#') && anchor(l) == fragment);
    let leads = fragment.is_empty() || has_heading();
    (!leads).then(|| format!("{}: {link}: there is no such heading", shown(document)))
}

fn report(problems: &[String]) {
    assert!(problems.is_empty(), "{} of them:\n{}", problems.len(), problems.join("\n"));
}

#[test]
fn documents_that_are_named_exist() {
    let mut files = texts_of(&[
        "src",
        "tests",
        "examples",
        "scripts",
        "docs",
        "dataset",
        "models",
        "README.md",
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        "Cargo.toml",
    ]);
    // This file names some that do not exist.
    files.retain(|file| !file.ends_with(file!()));
    assert!(files.len() > 100, "only {} files were found", files.len());
    let missing = |file: &PathBuf| {
        let named = named_documents(&read(file)).into_iter().filter(|name| !root().join(name).is_file());
        named.map(|name| format!("{} names {name}", shown(file))).collect::<Vec<_>>()
    };
    report(&files.iter().flat_map(missing).collect::<Vec<_>>());
}

#[test]
fn links_lead_somewhere() {
    let mut files = texts_of(&["docs", "dataset", "third_party", "README.md", "CHANGELOG.md", "CONTRIBUTING.md"]);
    files.retain(|file| file.extension().is_some_and(|e| e == "md"));
    let all = files.iter().flat_map(|file| links(&read(file)).into_iter().map(move |link| (file, link)));
    let all: Vec<_> = all.collect();
    assert!(all.len() > 20, "only {} links were found", all.len());
    report(&all.iter().filter_map(|(file, link)| broken(file, link)).collect::<Vec<_>>());
}

#[test]
fn a_missing_document_and_a_broken_link_are_seen() {
    assert_eq!(named_documents("see docs/a/b-c.md, eq. 3, and `docs/d.md`."), ["docs/a/b-c.md", "docs/d.md"]);
    let text = "[a](b.md) and [c](https://d.e), ![f](g.jpg), [h](#i)";
    assert_eq!(links(text), ["b.md", "g.jpg", "#i"]);
    let readme = root().join("README.md");
    assert!(broken(&readme, "docs/nothing.md").is_some());
    assert!(broken(&readme, "docs/formats.md#nothing").is_some());
    assert_eq!(broken(&readme, "docs/formats.md#runjson"), None);
}

#[test]
fn every_dependency_says_why_it_is_there() {
    let manifest: toml::Table = toml::from_str(&read(&root().join("Cargo.toml"))).unwrap();
    let reasons = read(&root().join("docs/dependencies.md"));
    let names = ["dependencies", "dev-dependencies"].map(|table| manifest[table].as_table().unwrap().keys());
    let silent = names.into_iter().flatten().filter(|name| !reasons.contains(&format!("`{name}`")));
    report(&silent.map(|name| format!("docs/dependencies.md has no line for {name}")).collect::<Vec<_>>());
}

#[test]
fn no_line_is_wider_than_the_code() {
    let mut files = texts_of(&WRAPPED);
    files.retain(|file| file.extension().is_some_and(|e| e == "rs"));
    assert!(files.len() > 50, "only {} files were found", files.len());
    let wide = |file: &PathBuf| {
        let text = read(file);
        let lines = text.lines().enumerate().filter(|(_, line)| line.chars().count() > MAX_COLUMNS);
        lines.map(|(k, _)| format!("{}:{}", shown(file), k + 1)).collect::<Vec<_>>()
    };
    report(&files.iter().flat_map(wide).collect::<Vec<_>>());
}
