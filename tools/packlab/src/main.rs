//! `packlab`: research without a cell. It makes boxes and judges methods on what the services run.
#![expect(clippy::print_stdout, reason = "tables are its work")]

mod evaluate;
mod generate;
mod method;
mod output;
mod published;
mod source;
mod trial;

use clap::{Parser, Subcommand};

/// Makes boxes, and judges packing methods on them.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Write episodes of a named data set to a file.
    Generate(generate::GenerateArgs),
    /// Run methods on the same episodes and compare them.
    Evaluate(evaluate::EvaluateArgs),
}

fn main() -> anyhow::Result<()> {
    match Args::parse().command {
        Command::Generate(args) => generate::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
    }
}
