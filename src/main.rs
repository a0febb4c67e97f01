//! The program; all of it is in the library.

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Bal(tractrix::cli::bal::BalArgs),
}

fn main() -> anyhow::Result<()> {
    match Cli::parse().command {
        Command::Bal(args) => tractrix::cli::bal::run(&args),
    }
}
