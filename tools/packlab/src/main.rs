//! `packlab`: research without a cell.

mod train;

use clap::Parser;

/// Learns, judges and reports packing policies; needs no running cell.
#[derive(Parser)]
#[command(version)]
enum Command {
    /// Learns a model and writes it to a file.
    Train(train::TrainArgs),
}

fn main() -> anyhow::Result<()> {
    match Command::parse() {
        Command::Train(args) => train::run(&args),
    }
}
