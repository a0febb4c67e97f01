//! What the documents promise of files is true: those that are named exist, links lead somewhere, and every dependency
//! has its reason. And no line of these rooms is wider than the code, comments and strings included.

#[path = "common/rust_source.rs"]
#[allow(dead_code)]
mod rust_source;

use std::fs;
use std::path::{Path, PathBuf};

use tractrix::scene::Topic;

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
        "python",
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
    let mut files =
        texts_of(&["docs", "dataset", "python", "third_party", "README.md", "CHANGELOG.md", "CONTRIBUTING.md"]);
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

/// First words of a doc summary that begins with a clause instead of an imperative or a noun phrase.
const CLAUSES: [&str; 4] = ["What ", "Whether ", "How ", "By how much "];
/// Words that engineers do not use in the sense in which the code used them (docs/glossary.md).
const BANNED: [&str; 8] = ["anew", "beside", "once more", "told", "said", "passed over", "hangs on", "stands for"];
/// Doc summaries and comment lines that still break the rules. A number here may only fall.
const CLAUSES_LEFT: usize = 0;
const BANNED_LEFT: usize = 0;

/// Doc summaries of a source that begin with a clause: the first line of every block of `///` or `//!`.
fn clauses(source: &str) -> usize {
    let doc = |line: &str| {
        let line = line.trim_start();
        line.strip_prefix("///").or_else(|| line.strip_prefix("//!")).map(|text| text.trim_start().to_owned())
    };
    let mut before = None;
    let mut count = 0;
    for line in source.lines() {
        let text = doc(line);
        if before.is_none() && text.as_ref().is_some_and(|text| CLAUSES.iter().any(|clause| text.starts_with(clause))) {
            count += 1;
        }
        before = text;
    }
    count
}

/// Banned words in the comments of a source.
fn banned(source: &str) -> usize {
    let comments = source.lines().filter_map(|line| line.split_once("//").map(|(_, comment)| comment.to_lowercase()));
    let words = |comment: &str, word: &str| {
        let is_letter = |c: char| c.is_alphanumeric() || c == '_';
        let bounded =
            |at: usize| !comment[..at].ends_with(is_letter) && !comment[at + word.len()..].starts_with(is_letter);
        comment.match_indices(word).filter(|&(at, _)| bounded(at)).count()
    };
    comments.map(|comment| BANNED.iter().map(|word| words(&comment, word)).sum::<usize>()).sum()
}

#[test]
fn comments_use_plain_english() {
    let (mut num_clauses, mut num_banned) = (0, 0);
    let mut worst: Vec<(usize, String)> = Vec::new();
    for path in texts_of(&["src"]).into_iter().filter(|path| path.extension().is_some_and(|end| end == "rs")) {
        let source = read(&path);
        let (clauses, banned) = (clauses(&source), banned(&source));
        num_clauses += clauses;
        num_banned += banned;
        worst.push((clauses + banned, shown(&path)));
    }
    worst.sort();
    let worst: Vec<_> = worst.iter().rev().take(10).collect();
    assert_eq!(
        num_clauses, CLAUSES_LEFT,
        "doc summaries that begin with {CLAUSES:?}; lower or meet the budget: {worst:?}"
    );
    assert_eq!(num_banned, BANNED_LEFT, "banned words in comments: {BANNED:?}; lower or meet the budget: {worst:?}");
}

/// Sources of the program without those of its tests.
fn production_sources() -> Vec<(PathBuf, String)> {
    let mut files = texts_of(&["src"]);
    files.retain(|file| file.extension().is_some_and(|e| e == "rs") && !shown(file).contains("tests"));
    let source = |file: PathBuf| {
        let text = read(&file);
        let production = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().to_owned();
        (file, production)
    };
    files.into_iter().map(source).collect()
}

/// Line numbers of constants that are numbers, or arrays or ranges of these, without a comment above them.
fn bare_constants(source: &str) -> Vec<usize> {
    let is_number = |word: &str| {
        ["usize", "isize", "Duration"].contains(&word) || word.trim_start_matches(['f', 'i', 'u']).parse::<u8>().is_ok()
    };
    let is_numeric = |line: &str| {
        let is_item = |before: &str| before.is_empty() || (before.starts_with("pub") && !before.contains('<'));
        let constant = line.split_once("const ").filter(|(before, _)| is_item(before));
        let kind = constant.and_then(|(_, named)| named.split_once(": ")).filter(|(name, _)| !name.contains(' '));
        let mut words = kind.map_or("", |(_, kind)| kind).split(|c: char| !c.is_alphanumeric());
        words.find(|word| !["", "std", "ops", "Range", "RangeInclusive"].contains(word)).is_some_and(is_number)
    };
    let lines = source.lines().map(str::trim_start).zip(1..).filter(|(line, _)| !line.starts_with("#["));
    let lines: Vec<(&str, usize)> = [("", 0)].into_iter().chain(lines).collect();
    let bare = lines.windows(2).filter(|pair| is_numeric(pair[1].0) && !pair[0].0.starts_with("//"));
    bare.map(|pair| pair[1].1).collect()
}

#[test]
fn every_constant_has_a_comment() {
    let compiled = rust_source::production_files(&root().join("src/lib.rs"));
    let problems = |(file, source): (PathBuf, String)| {
        let lines = bare_constants(&source).into_iter();
        lines.map(|line| format!("{}:{line}: a constant without a comment", shown(&file))).collect::<Vec<_>>()
    };
    let sources = production_sources().into_iter().filter(|(file, _)| compiled.iter().any(|c| c.path == *file));
    report(&sources.flat_map(problems).collect::<Vec<_>>());
    let sample = "/// A.\n#[x]\nconst A: f64 = 1.0;\npub(super) const B: &[u8; 1] = &[2];\nconst fn c(d: u8) {}\n";
    assert_eq!(bare_constants(sample), [4]);
}

/// Words that no message uses: former words of the glossary, and British spelling.
const NOT_IN_MESSAGES: [&str; 16] = [
    "anew",
    "beside",
    "besides",
    "once more",
    "told",
    "passed over",
    "hangs on",
    "metres",
    "picture",
    "pictures",
    "centre",
    "centres",
    "colour",
    "colours",
    "grey",
    "by looking",
];

/// Words of a message that it should not use: those of a literal with a blank, without its placeholders.
fn former_words(literal: &str) -> Vec<&'static str> {
    let text: String = literal.split('{').map(|part| part.split_once('}').map_or(part, |(_, text)| text)).collect();
    let text = format!(" {} ", text.to_lowercase().replace(|c: char| !c.is_alphanumeric(), " "));
    let is_message = literal.trim_matches(['"', ' ']).contains(' ') && !literal.contains('<');
    let used = NOT_IN_MESSAGES.into_iter().filter(|word| text.contains(&format!(" {word} ")));
    if is_message { used.collect() } else { Vec::new() }
}

#[test]
fn messages_use_plain_english() {
    let problems = |(file, source): (PathBuf, String)| {
        // Units of options, and panics that no input causes.
        let messages = source.lines().filter(|line| !line.contains("schemars(") && !line.contains(".expect("));
        let literals = rust_source::literals(&messages.collect::<Vec<_>>().join("\n")).into_iter();
        let used = literals.flat_map(|literal| former_words(&literal).into_iter().map(move |w| (w, literal.clone())));
        used.map(|(word, literal)| format!("{}: {word}: {literal}", shown(&file))).collect::<Vec<_>>()
    };
    report(&production_sources().into_iter().flat_map(problems).collect::<Vec<_>>());
    assert_eq!(former_words("\"the picture of {colour}, once more\""), ["once more", "picture"]);
    assert!(former_words("\"picture\"").is_empty());
}

const TROUBLESHOOTING: &str = "docs/troubleshooting.md";

#[test]
fn every_warning_has_a_section() {
    let page = read(&root().join(TROUBLESHOOTING));
    let sections: Vec<String> = page.lines().filter(|line| line.starts_with("### ")).map(anchor).collect();
    let missing = Topic::ALL.iter().map(|topic| topic.name()).filter(|anchor| !sections.iter().any(|s| s == anchor));
    report(&missing.map(|anchor| format!("{TROUBLESHOOTING} has no section {anchor}")).collect::<Vec<_>>());
    let untopical = |(file, source): (PathBuf, String)| {
        let calls = source.split("tracing::warn!(").skip(1).map(|call| call.split(';').next().unwrap_or_default());
        let bare = calls.filter(|call| !call.contains("Topic::") && !call.starts_with("\"{warning}\"")).count();
        (bare > 0).then(|| format!("{}: {bare} warnings without a topic", shown(&file)))
    };
    report(&production_sources().into_iter().filter_map(untopical).collect::<Vec<_>>());
}

/// Texts that a page quotes, cut at what varies.
fn quoted(markdown: &str) -> Vec<String> {
    let text = markdown.split("\n\n").map(|paragraph| paragraph.replace('\n', " ")).collect::<Vec<_>>().join("\n");
    let without_code: String = text.split('`').step_by(2).collect::<Vec<_>>().join("`");
    let quotes = without_code.split('"').skip(1).step_by(2).flat_map(|quote| quote.split('…'));
    quotes.map(|part| part.trim().trim_matches(['(', ')', '±', '%', ' ']).to_owned()).filter(|p| p.len() > 5).collect()
}

#[test]
fn quoted_messages_are_those_of_the_program() {
    let literals = production_sources().into_iter().flat_map(|(_, source)| rust_source::literals(&source));
    let program = literals.collect::<Vec<_>>().join("\n");
    let quotes = quoted(&read(&root().join(TROUBLESHOOTING)));
    assert!(quotes.len() > 60, "{quotes:?}");
    let foreign = quotes.into_iter().filter(|quote| !program.contains(quote.as_str()));
    report(&foreign.map(|quote| format!("{TROUBLESHOOTING} quotes “{quote}”")).collect::<Vec<_>>());
}

#[test]
fn clauses_and_banned_words_are_counted() {
    assert_eq!(clauses("/// What it is.\n/// How it is.\nfn a() {}\n/// Whether so.\nfn b() {}\n/// The whole.\n"), 2);
    assert_eq!(banned("let said = 1; // Done anew, beside it.\n/// Besides, retold.\n"), 2);
}
