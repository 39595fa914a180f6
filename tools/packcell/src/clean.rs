//! `packcell clean`: removes what stopped processes left on a bus.

use anyhow::bail;
use runtime::processes_on;

use crate::args::WhichCell;
use crate::owner::act_as_owner;
use crate::private_bus::remove_bus;

#[derive(Debug, clap::Args)]
pub(crate) struct CleanArgs {
    #[command(flatten)]
    which: WhichCell,
}

pub(crate) fn run(args: &CleanArgs) -> anyhow::Result<()> {
    let bus = args.which.config()?.bus;
    act_as_owner(&bus)?;
    let processes = processes_on(&bus)?;
    if processes > 0 {
        bail!("{processes} processes are on the bus {}: stop them first", bus.root_dir.display());
    }
    remove_bus(&bus.root_dir, &bus.prefix);
    Ok(())
}
