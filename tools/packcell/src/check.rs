//! `packcell check`: whether a configuration file is valid.

use std::path::PathBuf;

use runtime::Config;

#[derive(Debug, clap::Args)]
pub(crate) struct CheckArgs {
    /// The configuration file
    #[arg(value_name = "FILE", default_value = crate::args::INSTALLED)]
    file: PathBuf,
}

pub(crate) fn run(args: &CheckArgs) -> anyhow::Result<()> {
    let config = Config::load(&args.file, &[])?;
    let changed = Config::default().changed_keys(&config);
    let others = if changed.is_empty() {
        "every key has its default".to_owned()
    } else {
        format!("not as shipped: {}", changed.join(", "))
    };
    println!("{} is valid; {others}", args.file.display());
    Ok(())
}
