//! `peer`: one stage of the cell, or all of it, on Unix sockets. `packcell bench` starts it, and nobody else.
//!
//! The work is that of the services' libraries; only what carries the messages differs.

mod stages;

use std::path::PathBuf;

use clap::{Parser, ValueEnum};
use runtime::ServiceArgs;

/// Stands in for the cell's services on Unix sockets, for packcell bench.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    service: ServiceArgs,
    /// What it stands in for
    #[arg(value_enum)]
    stage: Stage,
    /// Directory of the sockets
    #[arg(long, value_name = "DIR")]
    sockets: PathBuf,
}

/// A part of the cell's work.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Stage {
    /// All three services in one process
    Alone,
    Candidates,
    Scorer,
    Commander,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let config = args.service.load()?;
    match args.stage {
        Stage::Alone => stages::alone(&config, &args.sockets),
        Stage::Candidates => stages::candidates(&config, &args.sockets),
        Stage::Scorer => stages::scorer(&config, &args.sockets),
        Stage::Commander => stages::commander(&config, &args.sockets),
    }
}
