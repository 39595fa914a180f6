//! `packcell manual`: the manual pages and shell completions that the package ships, made from the arguments
//! themselves.

use std::fs;
use std::path::PathBuf;

use anyhow::Context as _;
use clap_complete::Shell;

#[derive(Debug, clap::Args)]
pub(crate) struct ManualArgs {
    /// Directory to write to
    #[arg(value_name = "DIR")]
    dir: PathBuf,
}

pub(crate) fn run(args: &ManualArgs, command: &mut clap::Command) -> anyhow::Result<()> {
    let mut write = || {
        fs::create_dir_all(&args.dir)?;
        clap_mangen::generate_to(command.clone().disable_help_subcommand(true), &args.dir)?;
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            clap_complete::generate_to(shell, command, "packcell", &args.dir)?;
        }
        std::io::Result::Ok(())
    };
    write().with_context(|| format!("cannot write the manual to {}", args.dir.display()))
}
