//! `packcell up`: a cell that runs until Ctrl-C.

use std::fs::File;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use messages::topics::Role;
use runtime::{Bus, Config};
use rustix::fs::FlockOperation;

use crate::args::{CellArgs, expected_boxes};
use crate::cell::Cell;
use crate::private_bus::remove_bus;

/// How often the processes are looked after.
const LOOK: Duration = Duration::from_millis(50);

#[derive(Debug, clap::Args)]
pub(crate) struct UpArgs {
    #[command(flatten)]
    cell: CellArgs,
}

pub(crate) fn run(args: &UpArgs) -> anyhow::Result<()> {
    let mut config = args.cell.config()?;
    expected_boxes(&mut config)?;
    let (root_dir, prefix) = (config.bus.root_dir.clone(), config.bus.prefix.clone());
    std::fs::create_dir_all(&root_dir).with_context(|| format!("cannot create the bus {}", root_dir.display()))?;
    let lock =
        File::create(root_dir.join("lock")).with_context(|| format!("cannot use the bus {}", root_dir.display()))?;
    if rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive).is_err() {
        bail!(
            "a cell runs on the bus {} already: stop it, or give this one its own with \
             --set bus.root_dir=/dev/shm/NAME --set bus.prefix=NAME_",
            root_dir.display()
        );
    }
    let kept = keep_running(&config);
    remove_bus(&root_dir, &prefix);
    kept
}

fn keep_running(config: &Config) -> anyhow::Result<()> {
    let bus = Bus::join(&config.bus, Role::Tool)?;
    let mut cell = Cell::start(config, &bus)?;
    println!("the cell runs; 'packcell status' shows it, Ctrl-C stops it");
    while !bus.is_stopping() {
        cell.check()?;
        thread::sleep(LOOK);
    }
    cell.stop()?;
    println!("the cell has stopped");
    Ok(())
}
