//! `perception`: the stub of belt, containers, sensor and arm.
//!
//! Reads `packcell/commands`; writes `packcell/belief`, `packcell/boxes` and `packcell/motions`. An integrator
//! replaces it by whatever drives the real camera and arm.

mod world_file;

use anyhow::Context as _;
use clap::Parser;
use messages::topics::{BELIEF, BOXES, COMMANDS, MOTIONS, Role};
use packing::Grid;
use perception::{Behaviour, Belt, Perception, Reality, Say};
use runtime::{Bus, ReloadSignal, Reporter, ServiceArgs, monotonic_ns};
use tracing::info;
use world_file::WorldFile;

/// Stands in for the belt, the containers, the sensor and the arm.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    service: ServiceArgs,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse().service;
    let config = args.load()?;
    let (size, settings) = (config.container_size()?, &config.perception);
    let belt = Belt::open(&settings.stream, settings.seed, settings.episodes, size)?;
    let grid = Grid::with_rules(size, config.container.slots, config.rules())?;

    let bus = Bus::join(&config.bus, Role::Perception)?;
    let mut beliefs = bus.publisher(&BELIEF)?;
    let mut queues = bus.publisher(&BOXES)?;
    let mut motions = bus.publisher(&MOTIONS)?;
    let bell = bus.bell()?;
    let commands = bus.subscriber(&COMMANDS)?;
    let (mut file, world) = WorldFile::open(&config.state.world())?;
    let reality = Reality::of(&config, &grid);
    let resumed = match &world {
        Some(world) => Perception::resume(Behaviour::of(settings), &grid, belt, world, monotonic_ns()),
        None => Ok(Perception::new(Behaviour::of(settings), grid, belt, monotonic_ns())),
    };
    let remedy = || format!("cannot go on from {}; remove it to begin anew", config.state.world().display());
    let mut perception =
        resumed.and_then(|perception| perception.in_reality(reality, world.as_ref())).with_context(remedy)?;
    let mut say = Vec::new();
    perception.begin(&mut say);
    let mut reporter = Reporter::new(&bus, &format!("stub: {}", settings.stream))?;
    info!(goes_on = world.is_some(), "ready: {}", settings.stream);

    let mut reload = ReloadSignal::catch(args, config)?;
    while bell.wait(if perception.is_changed() { None } else { perception.wake_ns() })? {
        if let Some(config) = reload.take() {
            perception.set_behaviour(Behaviour::of(&config.perception), monotonic_ns());
        }
        while !perception.is_changed()
            && let Some(command) = commands.receive()?
        {
            perception.on_command(&command, monotonic_ns(), &mut say);
        }
        if !perception.is_changed() {
            perception.on_time(monotonic_ns(), &mut say);
        }
        // Nobody is told what is not kept; until it is, the belt and the arm stand still.
        if file.keep(&mut perception) {
            for said in say.drain(..) {
                match said {
                    Say::Motion(report) => motions.publish(0, |motion| *motion = report)?,
                    Say::Belief => beliefs.publish(0, |belief| belief.update(perception.grid()))?,
                    Say::Boxes(observed_ns) => queues.publish(observed_ns, |queue| perception.write_boxes(queue))?,
                };
            }
        }
        beliefs.greet_newcomers()?;
        motions.greet_newcomers()?;
        reporter.report_if_due(perception.tally())?;
    }
    info!("stopped");
    Ok(())
}
