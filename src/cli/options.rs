//! `options`: every option with its value, and the page that explains them all.

use std::fmt::Write;

use super::common::CommonArgs;
use super::output::{Failure, Form, print, show};
use crate::pipeline::{OptionRow, OptionSection, Options};

#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// List only options whose path contains this text
    pub(super) part: Option<String>,
    /// Print docs/options.md
    #[arg(long, hide = true)]
    pub(super) markdown: bool,
    #[command(flatten)]
    pub(super) common: CommonArgs,
}

pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    if args.markdown {
        return print(&markdown(&Options::reference()));
    }
    let options = args.common.options()?;
    options.check()?;
    let part = args.part.as_deref().unwrap_or_default();
    let lines: Vec<String> = options.rows().iter().filter(|row| row.key.contains(part)).map(line).collect();
    if lines.is_empty() {
        return Err(Failure::Usage(format!("no option path contains '{part}'; `tractrix options` lists all")));
    }
    show(form, &options, || lines.join("\n") + "\n")
}

/// An option on one line: its value, and in brackets the unit, and the default where that is another.
fn line(row: &OptionRow) -> String {
    let (value, default) = (&row.values[0], &row.values[1]);
    let default = (value != default).then(|| format!("default {default}"));
    let notes: Vec<String> = row.unit.iter().cloned().chain(default).collect();
    match notes.is_empty() {
        true => format!("{} = {value}", row.key),
        false => format!("{} = {value}  ({})", row.key, notes.join("; ")),
    }
}

const INTRODUCTION: &str = "\
# Options

Everything that decides a result, with defaults. This page is made from the code: `tractrix options --markdown`.

    tractrix run video.mp4 --output out --set ground.max_error_px=3 --set background.mapper.max_starts=5
    tractrix run video.mp4 --output out --options mine.json
    tractrix options --options mine.json            # every option with its value, unit, and default if it is another
    tractrix options --json > mine.json             # the whole tree, to be changed

A file given with `--options` holds such a tree, or a part of it: what it leaves out keeps its default. A `run.json`
will do, too: its options are taken. `--set KEY=VALUE` goes before the file and takes JSON or a word; flags of their own
(`--seed`, `--every`, ...) go before both. A key that does not exist, and a value that makes no sense, are refused by
their path.

Where a value is one of several words or forms, the effect names them. `null` stands for what is not given.
";

/// The page: a table for each section.
fn markdown(sections: &[OptionSection]) -> String {
    sections.iter().fold(INTRODUCTION.to_owned(), |page, section| page + "\n" + &table(section))
}

fn table(section: &OptionSection) -> String {
    let mut text = format!("## {}\n\n{}\n\n", section.title, section.about);
    // Writing to a string cannot fail.
    let _ = writeln!(text, "| option | {} | unit | effect |", section.columns.join(" | "));
    let _ = writeln!(text, "| --- |{} --- | --- |", " --- |".repeat(section.columns.len()));
    for row in &section.rows {
        let values: Vec<String> = row.values.iter().map(|value| format!("`{value}`")).collect();
        let cells = [format!("`{}`", row.key), values.join(" | "), row.unit.clone().unwrap_or_default()];
        let _ = writeln!(text, "| {} | {} |", cells.join(" | "), row.effect.replace('|', "\\|"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_that_of_the_code() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/options.md");
        let current = markdown(&Options::reference());
        if std::env::var_os("TRACTRIX_RENEW").is_some() {
            std::fs::write(&path, &current).unwrap();
        }
        let page = std::fs::read_to_string(path).unwrap_or_default();
        assert!(
            page == current,
            "docs/options.md is not up to date; renew it: tractrix options --markdown > docs/options.md"
        );
    }

    #[test]
    fn every_option_says_what_it_does_and_every_number_its_unit() {
        let sections = Options::reference();
        assert!(sections.len() > 10, "{}", sections.len());
        for row in sections.iter().flat_map(|section| &section.rows) {
            assert!(row.effect.len() > 15, "{row:?}");
            let is_number = row.values.iter().any(|value| value.parse::<f64>().is_ok());
            assert!(!is_number || row.unit.is_some(), "{row:?}");
        }
    }

    #[test]
    fn lines_name_the_default_where_it_is_another() {
        let options = Options::default().with_value("ground.max_error_px", "3").unwrap();
        let lines: Vec<String> = options.rows().iter().map(line).collect();
        let has = |line: &str| lines.iter().any(|other| other == line);
        assert!(has("ground.max_error_px = 3.0  (pixels; default 4.0)"), "{lines:#?}");
        assert!(has("ground.min_points = 10  (points)"), "{lines:#?}");
        assert!(has("background.front_end.min_correlation = 0.7  (correlation)"), "{lines:#?}");
    }

    #[test]
    fn another_front_end_is_compared_with_its_own_defaults() {
        let options = Options::default().with_value("objects.front_end.kind", "sift").unwrap();
        let rows = options.rows();
        let changed: Vec<&str> =
            rows.iter().filter(|row| row.values[0] != row.values[1]).map(|row| row.key.as_str()).collect();
        assert_eq!(changed, ["objects.front_end.kind"]);
        assert!(rows.iter().any(|row| row.key == "objects.front_end.features.doubled"));
    }
}
