//! Just enough of Rust's grammar to ask what production code names: words and signs without comments and literals,
//! items that are compiled for tests alone, modules, and paths that begin with `crate` or `super`.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// A file of production code: where it is, which module it is (`["sfm", "mapper"]`), and its tokens.
pub struct SourceFile {
    pub path: PathBuf,
    pub module: Vec<String>,
    pub tokens: Vec<String>,
}

/// Every file that production code consists of: those reached by `mod name;` from `root`, unless for tests alone.
pub fn production_files(root: &Path) -> Vec<SourceFile> {
    let mut found: Vec<SourceFile> = Vec::new();
    let mut open = vec![(root.to_owned(), Vec::new())];
    while let Some((path, module)) = open.pop() {
        let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let tokens = production(&tokens(&text));
        for name in declared_modules(&tokens) {
            let child = module.iter().cloned().chain([name.clone()]).collect();
            open.push((file_of_child(&path, &name), child));
        }
        found.push(SourceFile { path, module, tokens });
    }
    found
}

/// Where the module lies that `path` declares as `mod name;`.
fn file_of_child(path: &Path, name: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default();
    let folder = match stem.to_str() {
        Some("lib" | "mod") => path.with_file_name(""),
        _ => path.with_extension(""),
    };
    let flat = folder.join(format!("{name}.rs"));
    if flat.is_file() { flat } else { folder.join(name).join("mod.rs") }
}

/// Words and single signs. Comments are left out; a string or character literal stands as `""`.
pub fn tokens(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let (length, token) = next_token(rest, first);
        found.extend(token.map(str::to_owned));
        rest = &rest[length..];
    }
    found
}

/// String literals as they are written, without the line breaks of continued ones.
pub fn literals(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let (length, token) = next_token(rest, first);
        if token == Some("\"\"") && first != '\'' {
            found.push(joined(&rest[..length]));
        }
        rest = &rest[length..];
    }
    found
}

/// A literal on one line: a backslash at the end of a line takes the blanks of the next with it.
fn joined(literal: &str) -> String {
    let mut lines = literal.split("\\\n");
    let first = lines.next().unwrap_or_default().to_owned();
    lines.fold(first, |text, line| text + line.trim_start())
}

/// How much of `text` its first token takes, and the token; `None` for what is no code.
fn next_token(text: &str, first: char) -> (usize, Option<&str>) {
    if text.starts_with("//") {
        (text.find('\n').unwrap_or(text.len()), None)
    } else if text.starts_with("/*") {
        (block_comment_len(text), None)
    } else if let Some(length) = literal_len(text) {
        (length, Some("\"\""))
    } else if is_word(first) {
        let length = text.find(|c| !is_word(c)).unwrap_or(text.len());
        (length, Some(&text[..length]))
    } else {
        let length = first.len_utf8();
        (length, (!first.is_whitespace()).then_some(&text[..length]))
    }
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Block comments nest.
fn block_comment_len(text: &str) -> usize {
    let (mut at, mut depth) = (0, 0);
    while at < text.len() {
        let step = match &text.as_bytes()[at..] {
            [b'/', b'*', ..] => (2, 1),
            [b'*', b'/', ..] => (2, -1),
            _ => (1, 0),
        };
        at += step.0;
        depth += step.1;
        if depth == 0 {
            return at;
        }
    }
    text.len()
}

/// The length of the string or character literal that `text` begins with, with its prefix.
fn literal_len(text: &str) -> Option<usize> {
    let prefix = ["br", "cr", "r", "b", "c", ""].into_iter().find(|prefix| {
        let rest = text.strip_prefix(prefix).unwrap_or_default();
        rest.starts_with('"')
            || (prefix.ends_with('r') && rest.trim_start_matches('#').starts_with('"'))
            || (matches!(*prefix, "" | "b") && rest.starts_with('\''))
    })?;
    let body = &text[prefix.len()..];
    let length = match body.chars().next()? {
        '\'' => character_len(body)?,
        _ if prefix.ends_with('r') => raw_string_len(body),
        _ => quoted_len(body, '"'),
    };
    Some(prefix.len() + length)
}

fn raw_string_len(text: &str) -> usize {
    let hashes = text.len() - text.trim_start_matches('#').len();
    let end = format!("\"{}", "#".repeat(hashes));
    text[hashes + 1..].find(&end).map_or(text.len(), |at| hashes + 1 + at + end.len())
}

/// The length of a character literal; `None` for a lifetime.
fn character_len(text: &str) -> Option<usize> {
    let mut inner = text.chars().skip(1);
    let first = inner.next()?;
    (first == '\\' || inner.next() == Some('\'')).then(|| quoted_len(text, '\''))
}

/// The length of a literal between two of the same quotes, in which a backslash protects the next character.
fn quoted_len(text: &str, quote: char) -> usize {
    let mut is_protected = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            _ if is_protected => is_protected = false,
            '\\' => is_protected = true,
            c if c == quote => return at + 1,
            _ => {}
        }
    }
    text.len()
}

/// The tokens without the items that stand under `#[cfg(test)]`, whatever kind of item it is and wherever it stands.
pub fn production(tokens: &[String]) -> Vec<String> {
    let mut kept = Vec::new();
    let mut rest = tokens;
    while !rest.is_empty() {
        if starts_with(rest, &["#", "[", "cfg", "(", "test", ")", "]"]) {
            rest = &rest[item_len(rest)..];
        } else {
            kept.push(rest[0].clone());
            rest = &rest[1..];
        }
    }
    kept
}

fn starts_with(tokens: &[String], expected: &[&str]) -> bool {
    tokens.len() >= expected.len() && tokens.iter().zip(expected).all(|(token, wanted)| token == wanted)
}

/// The number of tokens of an item with its attributes: up to `;`, or to the end of its `{...}`.
fn item_len(tokens: &[String]) -> usize {
    let mut depth = 0;
    for (at, token) in tokens.iter().enumerate() {
        match token.as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" => depth -= 1,
            "}" => {
                depth -= 1;
                if depth == 0 {
                    return at + 1;
                }
            }
            ";" if depth == 0 => return at + 1,
            _ => {}
        }
    }
    tokens.len()
}

/// The names in `mod name;`.
pub fn declared_modules(tokens: &[String]) -> Vec<String> {
    let declared = tokens.windows(3).filter(|w| w[0] == "mod" && w[2] == ";");
    declared.map(|w| w[1].clone()).collect()
}

/// The rooms that code of `module` names, by whatever path: `crate::room`, `use crate::{room, other::{a, b}}`,
/// `super::super::room`. A glob or a new name for the whole crate counts as the room `*`.
pub fn named_rooms(tokens: &[String], module: &[String]) -> BTreeSet<String> {
    let mut inline: Vec<(usize, String)> = Vec::new();
    let (mut depth, mut rooms) = (0, BTreeSet::new());
    for (at, token) in tokens.iter().enumerate() {
        match token.as_str() {
            "{" => {
                depth += 1;
                if at >= 2 && tokens[at - 2] == "mod" {
                    inline.push((depth, tokens[at - 1].clone()));
                }
            }
            "}" => {
                inline.retain(|(opened, _)| *opened < depth);
                depth = depth.saturating_sub(1);
            }
            "crate" | "super" if at == 0 || tokens[at - 1] != ":" => {
                let here: Vec<&str> =
                    module.iter().map(String::as_str).chain(inline.iter().map(|(_, n)| n.as_str())).collect();
                let paths = paths(&tokens[at..]);
                rooms.extend(paths.iter().filter_map(|path| absolute(&here, path).first().map(|r| r.to_string())));
            }
            _ => {}
        }
    }
    rooms
}

/// A path from the crate's root on.
fn absolute<'a>(module: &[&'a str], path: &[&'a str]) -> Vec<&'a str> {
    let mut at = module.to_vec();
    for segment in path {
        match *segment {
            "crate" => at.clear(),
            "self" => {}
            "super" => drop(at.pop()),
            name => at.push(name),
        }
    }
    at
}

/// The paths that begin with the first token: one, or as many as a `{...}` makes of it.
fn paths(tokens: &[String]) -> Vec<Vec<&str>> {
    let mut found = Vec::new();
    read_tree(tokens, &[], &mut found);
    found
}

/// Reads `{...}` or `name`, `name::...`, `name as other`; returns what comes after.
fn read_tree<'a>(tokens: &'a [String], path: &[&'a str], found: &mut Vec<Vec<&'a str>>) -> &'a [String] {
    let longer = |name: &'a String| [path, &[name.as_str()]].concat();
    match tokens {
        [] => tokens,
        [open, after @ ..] if open == "{" => read_list(after, path, found),
        [name, a, b, after @ ..] if a == ":" && b == ":" => read_tree(after, &longer(name), found),
        [name, renamed, _, after @ ..] if renamed == "as" => {
            found.push([longer(name), vec!["*"]].concat());
            after
        }
        [name, after @ ..] => {
            found.push(longer(name));
            after
        }
    }
}

/// Reads on to the `}` that closes a list.
fn read_list<'a>(mut tokens: &'a [String], path: &[&'a str], found: &mut Vec<Vec<&'a str>>) -> &'a [String] {
    while let [first, after @ ..] = tokens {
        tokens = match first.as_str() {
            "}" => return after,
            "," => after,
            _ => read_tree(tokens, path, found),
        };
    }
    tokens
}
