//! `packcell`: operates a packing cell.
#![expect(clippy::print_stdout, reason = "printing is what a tool does")]

mod args;
mod cell;
mod demo;
mod journal_list;
mod latency;
mod page;
mod private_bus;
mod restart;
mod session;
mod soak;
mod status;
mod swap;
mod up;

use std::process::ExitCode;

use clap::Parser;

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
    /// Shows what every process of a running cell is doing
    Status(status::StatusArgs),
    /// Replaces the scorer of a running cell, without a pause
    Swap(swap::SwapArgs),
    /// Prints what the commander wrote down: every order and its outcome
    Journal(journal_list::JournalArgs),
}

fn main() -> ExitCode {
    let done = match Command::parse() {
        Command::Demo(args) => demo::run(&args),
        Command::Up(args) => up::run(&args),
        Command::Soak(args) => soak::run(&args),
        Command::Baseline(args) => soak::run_baseline(&args),
        Command::Status(args) => status::run(&args),
        Command::Swap(args) => swap::run(&args),
        Command::Journal(args) => journal_list::run(&args),
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
