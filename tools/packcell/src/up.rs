//! `packcell up`: a cell that runs until Ctrl-C, whatever dies meanwhile.

use std::fs::{self, File};
use std::io;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, bail};
use messages::topics::{CONTROL, Role};
use messages::{Control, Instance, Wish};
use runtime::{Bus, Config, monotonic_ns};
use rustix::fs::FlockOperation;

use crate::args::{CellArgs, expected_boxes};
use crate::cell::Cell;
use crate::private_bus::remove_bus;

/// How often the processes are looked after.
const LOOK: Duration = Duration::from_millis(10);

/// How often the dead are cleaned up after: the commander does it too, but it may be among them [ns].
const CLEANING_NS: u64 = 1_000_000_000;

#[derive(Debug, clap::Args)]
pub(crate) struct UpArgs {
    #[command(flatten)]
    cell: CellArgs,
    /// Begin with empty containers and the first box, and forget the world of an earlier run
    #[arg(long)]
    fresh: bool,
}

pub(crate) fn run(args: &UpArgs) -> anyhow::Result<()> {
    let mut config = args.cell.config()?;
    expected_boxes(&mut config)?;
    let (root_dir, prefix) = (config.bus.root_dir.clone(), config.bus.prefix.clone());
    fs::create_dir_all(&root_dir).with_context(|| format!("cannot create the bus {}", root_dir.display()))?;
    let lock =
        File::create(root_dir.join("lock")).with_context(|| format!("cannot use the bus {}", root_dir.display()))?;
    if rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive).is_err() {
        bail!(
            "a cell runs on the bus {} already: stop it, or give this one its own with \
             --set bus.root_dir=/dev/shm/NAME --set bus.prefix=NAME_ --set state.dir=DIR",
            root_dir.display()
        );
    }
    if args.fresh {
        remove_if_there(&config.state.world())?;
    }
    if args.cell.names_policy() {
        for instance in config.state.scorers() {
            remove_if_there(&config.state.scorer(instance))?;
            println!("scorer {instance}: the model that was swapped in earlier gives way to --policy and --model");
        }
    }
    let kept = keep_running(&config);
    remove_bus(&root_dir, &prefix);
    kept
}

fn keep_running(config: &Config) -> anyhow::Result<()> {
    let bus = Bus::join(&config.bus, Role::Tool)?;
    let controls = bus.subscriber(&CONTROL)?;
    let mut cell = Cell::start(config, &scorers(config)?, &bus)?;
    println!(
        "the cell runs; 'packcell status' shows it, Ctrl-C stops it; its state is in {}",
        config.state.dir.display()
    );
    let (mut restarts, mut cleaning_due_ns) = (0, 0);
    while !bus.is_stopping() {
        while let Some(control) = controls.receive()? {
            obey(&control, &mut cell)?;
        }
        cell.tend()?;
        if cell.restarts() > restarts {
            restarts = cell.restarts();
            println!("{restarts} restart(s) so far");
        }
        if monotonic_ns() >= cleaning_due_ns {
            bus.clean_up_after_the_dead();
            cleaning_due_ns = monotonic_ns() + CLEANING_NS;
        }
        thread::sleep(LOOK);
    }
    cell.stop()?;
    println!("the cell has stopped");
    Ok(())
}

/// What concerns whoever supervises the processes; the rest is for the commander.
pub(crate) fn obey(control: &Control, cell: &mut Cell) -> anyhow::Result<()> {
    let wish = Wish::from_wire(control.wish).and_then(|wish| Ok((wish, Instance::from_wire(control.instance)?)));
    match wish {
        Ok((Wish::Start, instance)) => cell.start_scorer(instance),
        Ok((Wish::Retire, instance)) => cell.retire_scorer(instance),
        Ok((Wish::Promote, _)) => Ok(()),
        Err(malformed) => {
            tracing::warn!(%malformed, "refused a wish");
            Ok(())
        }
    }
}

/// The scorers to run: those that were swapped in, and the one that the commander will obey.
fn scorers(config: &Config) -> anyhow::Result<Vec<Instance>> {
    let path = config.state.journal();
    let contents = match journal::read(&path) {
        Ok(contents) => contents,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(vec![Instance::default()]),
        Err(error) => return Err(error).with_context(|| format!("cannot read the journal {}", path.display())),
    };
    let active = Instance::from_wire(contents.state().active).unwrap_or_default();
    let mut scorers = config.state.scorers();
    if !scorers.contains(&active) {
        scorers.push(active);
    }
    Ok(scorers)
}

fn remove_if_there(path: &PathBuf) -> anyhow::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}
