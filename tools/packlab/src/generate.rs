//! `packlab generate`: episodes of a named data set as a file.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use dataset::{EPISODES_MAX, Named};
use packing::Split;

/// What to write and where.
#[derive(Debug, Args)]
pub(crate) struct GenerateArgs {
    /// Data set: standard, cut-order, fine, small-boxes, three, balanced or ten.
    #[arg(long, default_value = "standard")]
    data: String,
    /// Number of episodes.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=EPISODES_MAX as i64))]
    episodes: u32,
    /// Seed; the same seed gives the same boxes on every machine. Test episodes: no training ever sees them.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// File to write; its ending says how: .json, or .csv (which keeps neither the container nor the optimum).
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn run(args: &GenerateArgs) -> anyhow::Result<()> {
    let named = Named::find(&args.data)?;
    let set = named.generate(Split::Test, args.seed, args.episodes as usize).context("the episodes cannot be made")?;
    dataset::write(&args.out, &set)?;
    let boxes: usize = set.episodes.iter().map(Vec::len).sum();
    println!("{}: {} episodes, {boxes} boxes, {}", args.out.display(), set.episodes.len(), named.about);
    Ok(())
}
