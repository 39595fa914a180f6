//! `packcell`: operates a packing cell.
#![expect(clippy::print_stdout, reason = "printing is what a tool does")]

mod args;
mod bench;
mod cell;
mod check;
mod clean;
mod demo;
mod journal_list;
mod latency;
mod manual;
mod owner;
mod page;
mod private_bus;
mod restart;
mod session;
mod soak;
mod status;
mod swap;
mod up;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser};

/// Operates a packing cell: four processes that answer every box with a placement.
#[derive(Parser)]
#[command(version)]
enum Command {
    /// Packs one stream of boxes through a cell of its own, and reports how it went
    Demo(demo::DemoArgs),
    /// Keeps a cell running until Ctrl-C
    Up(up::UpArgs),
    /// Packs boxes for hours, harms the cell on schedule, and reports what became of every box
    Soak(soak::SoakArgs),
    /// Measures the machine itself beside a soak
    #[command(hide = true)]
    Baseline(soak::BaselineArgs),
    /// Measures the whole decision: over four processes, in one, and over Unix sockets instead of the bus
    Bench(bench::BenchArgs),
    /// Shows what every process of a running cell is doing
    Status(status::StatusArgs),
    /// Replaces the scorer of a running cell, without a pause
    Swap(swap::SwapArgs),
    /// Prints what the commander wrote down: every order and its outcome
    Journal(journal_list::JournalArgs),
    /// Says whether a configuration file is valid
    Check(check::CheckArgs),
    /// Removes what stopped processes left on a bus; one that is in use is left alone
    Clean(clean::CleanArgs),
    /// Writes the manual pages and shell completions, for packages
    #[command(hide = true)]
    Manual(manual::ManualArgs),
}

fn main() -> ExitCode {
    let done = match Command::parse() {
        Command::Demo(args) => demo::run(&args),
        Command::Up(args) => up::run(&args),
        Command::Soak(args) => soak::run(&args),
        Command::Baseline(args) => soak::run_baseline(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Status(args) => status::run(&args),
        Command::Swap(args) => swap::run(&args),
        Command::Journal(args) => journal_list::run(&args),
        Command::Check(args) => check::run(&args),
        Command::Clean(args) => clean::run(&args),
        Command::Manual(args) => manual::run(&args, &mut Command::command()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            runtime::init_log(runtime::LogLevel::Error);
            tracing::error!("{error:#}");
            ExitCode::FAILURE
        }
    }
}
