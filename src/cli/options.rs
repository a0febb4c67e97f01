//! `options`: options with their values, and the page of the public ones.

use std::fmt::Write;

use super::common::CommonArgs;
use super::output::{Failure, Form, print, show};
use crate::pipeline::{OptionRow, OptionSection, Options};

#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// List only options whose path contains this text
    pub(super) part: Option<String>,
    /// List internal options (`tuning.*`), too, and their effects
    #[arg(long)]
    pub(super) all: bool,
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
    let rows = options.rows();
    let of_part: Vec<&OptionRow> = rows.iter().filter(|row| row.key.contains(part)).collect();
    // An internal option that is set concerns everybody.
    let is_shown = |row: &&&OptionRow| args.all || row.is_public || row.values[0] != row.values[1];
    let lines: Vec<String> = of_part.iter().filter(is_shown).map(|row| line(row)).collect();
    match (lines.is_empty(), of_part.first()) {
        (true, Some(row)) => {
            let problem = format!("'{part}': only internal options contain it, for example {}", row.key);
            return Err(Failure::Usage(format!("{problem}; add --all")));
        }
        (true, None) => {
            return Err(Failure::Usage(format!(
                "no option path contains '{part}'; `tractrix options --all` lists all"
            )));
        }
        _ => {}
    }
    show(form, &options.to_json(), || lines.join("\n") + "\n")
}

/// An option on one line: its value; in brackets the unit, and the default if it differs; the effect of an internal
/// one.
fn line(row: &OptionRow) -> String {
    let (value, default) = (&row.values[0], &row.values[1]);
    let default = (value != default).then(|| format!("default {default}"));
    let notes: Vec<String> = row.unit.iter().cloned().chain(default).collect();
    let notes = if notes.is_empty() { String::new() } else { format!("  ({})", notes.join("; ")) };
    let effect = if row.is_public { String::new() } else { format!("  # {}", row.effect) };
    format!("{} = {value}{notes}{effect}", row.key)
}

const INTRODUCTION: &str = "\
# Options

Options that depend on the footage or on what is wanted, with defaults; most have a flag. This page is generated:
`tractrix options --markdown`.

    tractrix run video.mp4 --output out --set ground.max_error_px=3 --set background.mapper.max_starts=5
    tractrix run video.mp4 --output out --options mine.json
    tractrix options --options mine.json     # options with value, unit, and default if it differs
    tractrix options --json > mine.json      # the whole tree, to be edited

A file for `--options` holds such a tree or a part of it; missing options keep their defaults. A `run.json` works too.
`--set KEY=VALUE` overrides the file and takes JSON or a word; flags override both. Unknown keys and invalid values are
refused by their path. `null` means not given.

About 125 further options are internal: thresholds, solver settings and switches of single mechanisms, for contributors
who tune or ablate (CONTRIBUTING). Their paths begin with `tuning.`, for example
`tuning.scale.joint.independent_points`; `tractrix options --all` lists them with their effects. They may change
with every version.
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
        assert!(sections.len() > 8, "{}", sections.len());
        for row in sections.iter().flat_map(|section| &section.rows).chain(&Options::default().rows()) {
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
        assert!(
            lines
                .iter()
                .any(|line| line
                    .starts_with("tuning.background.front_end.video.min_correlation = 0.7  (correlation)  # ")),
            "{lines:#?}"
        );
    }
}
