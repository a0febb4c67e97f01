//! `tractrix benchmark --ablate`: every sequence again without single mechanisms.
//!
//! A run without a mechanism begins with a copy of the sequence's results, in which only the stages that depend on the
//! switched option run again. The copy is removed when the run is evaluated; results are kept in `ablation.json`.

use std::fs;
use std::path::Path;

use anyhow::Context;

use super::single::{Attempt, sequence};
use crate::cli::output::Failure;
use crate::eval::benchmark::{AblatedRun, Ablations, Effect, Entry};
use crate::io::{self, FolderError, OwnedFolder, RunFolder};
use crate::pipeline::{Ablation, Options};
use crate::report::benchmark as pages;

/// Version of `ablation.json`.
const VERSION: u32 = 1;
pub(super) const JSON: &str = "ablation.json";
pub(super) const MARKDOWN: &str = "ablation.md";

/// Ablations of a benchmark.
pub(super) struct Ablating {
    wanted: Vec<Ablation>,
    found: Ablations,
}

impl Ablating {
    /// With the results of an earlier call that were made by this program with these options.
    pub(super) fn new(wanted: Vec<Ablation>, options: &Options, output: &OwnedFolder) -> Self {
        let none = Ablations {
            version: VERSION,
            program: crate::VERSION.into(),
            options: options.to_json(),
            runs: Vec::new(),
        };
        let is_same = |found: &Ablations| (&found.program, &found.options) == (&none.program, &none.options);
        let found: Option<Ablations> = io::json::read(&output.root().join(JSON)).ok().filter(is_same);
        Self { wanted, found: found.unwrap_or(none) }
    }

    /// Runs one sequence without each mechanism, and writes the results so far.
    ///
    /// # Errors
    /// As of the sequence itself; options that the chosen front end does not have.
    pub(super) fn run(&mut self, attempt: &Attempt<'_>, with: &[Entry]) -> Result<(), Failure> {
        let name = attempt.folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let results = attempt.results.subfolder(&name)?;
        let copy = attempt.results.root().join(RunFolder::STATE).join("ablated");
        for ablation in self.wanted.clone() {
            let is_done = |run: &AblatedRun| {
                run.without == ablation.name && run.entry.folder == name && run.entry.failure.is_none()
            };
            if self.found.runs.iter().any(is_done) {
                continue;
            }
            attempt.talk.say(&format!("{name} without {}", ablation.name));
            let options = ablation.without(attempt.options).map_err(|error| Failure::Usage(error.to_string()))?;
            let folder_problem = || format!("{}: cannot be written; make room", copy.display());
            remove(&copy).with_context(folder_problem)?;
            copy_folder(&results, &copy).with_context(folder_problem)?;
            let entry = sequence(&Attempt { options: &options, output: Some(&copy), ..*attempt })?;
            remove(&copy).with_context(folder_problem)?;
            self.found.runs.retain(|run| !(run.without == ablation.name && run.entry.folder == name));
            let Ablation { name: without, decision, .. } = ablation;
            self.found.runs.push(AblatedRun { without: without.into(), decision, entry });
            self.write(attempt.results, with)?;
        }
        Ok(())
    }

    /// Effects of the wanted mechanisms.
    pub(super) fn effects(&self, with: &[Entry]) -> Vec<Effect> {
        let mut effects = self.found.effects(with);
        effects.retain(|effect| self.wanted.iter().any(|ablation| ablation.name == effect.name));
        effects
    }

    /// The same as a table.
    pub(super) fn table(&self, with: &[Entry]) -> String {
        pages::ablation_table(&self.effects(with))
    }

    fn write(&self, output: &OwnedFolder, with: &[Entry]) -> Result<(), FolderError> {
        let page = format!("# Ablation\n\ntractrix {}\n\n{}", crate::VERSION, self.table(with));
        output.put_json(JSON, &self.found)?;
        output.put_text(MARKDOWN, &page)
    }
}

fn remove(folder: &Path) -> std::io::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Copies a folder; links in it are skipped.
fn copy_folder(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let (kind, to) = (entry.file_type()?, to.join(entry.file_name()));
        if kind.is_dir() {
            copy_folder(&entry.path(), &to)?;
        } else if kind.is_file() {
            fs::copy(entry.path(), to)?;
        }
    }
    Ok(())
}
