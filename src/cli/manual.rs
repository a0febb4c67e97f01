//! `completions` and `manual`: what shells and `man` want to know of the command line, made from its definition.

use std::fs;
use std::path::PathBuf;

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;
use serde_json::json;

use super::output::{Failure, Form, print, show};

#[derive(Debug, clap::Args)]
pub(super) struct CompletionsArgs {
    /// Shell
    #[arg(value_enum)]
    shell: Shell,
}

#[derive(Debug, clap::Args)]
pub(super) struct ManualArgs {
    /// Folder for the pages; created if missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Prints the completions for one shell.
pub(super) fn completions(args: &CompletionsArgs, mut program: Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "tractrix", &mut script);
    print(&String::from_utf8_lossy(&script))
}

/// Writes `tractrix.1` and, for every command, `tractrix-<command>.1`. They hold no date: one program has one manual.
pub(super) fn pages(args: &ManualArgs, program: Command, form: Form) -> Result<(), Failure> {
    let folder = &args.output;
    let written = fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(program, folder));
    written.with_context(|| format!("{}: the manual pages cannot be written", folder.display()))?;
    show(form, &json!({ "folder": folder.to_string_lossy() }), || format!("manual pages: {}\n", folder.display()))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::args::Args;

    #[test]
    fn every_command_has_a_page_that_names_its_flags() {
        let folder = tempfile::tempdir().unwrap();
        let args = ManualArgs { output: folder.path().join("man1") };
        pages(&args, Args::command(), Form::Nothing).unwrap();
        let page = |name: &str| fs::read_to_string(args.output.join(name)).unwrap();
        let (program, run) = (page("tractrix.1"), page("tractrix-run.1"));
        assert!(program.contains("run(1)") && program.contains("doctor(1)"), "{program}");
        assert!(run.contains("intrinsics") && run.contains("quiet"), "{run}");
    }

    #[test]
    fn shells_learn_the_commands() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Args::command(), "tractrix", &mut script);
            let script = String::from_utf8(script).unwrap();
            assert!(script.contains("doctor") && script.contains("only-object"), "{shell}");
        }
    }
}
