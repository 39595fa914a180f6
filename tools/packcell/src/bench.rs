//! `packcell bench`: the whole decision over four processes, beside the same processes on Unix sockets and beside the
//! same work in one process.
//!
//! The three take turns box by box, on the same boxes and the same containers, so that whatever else the machine does
//! meets all of them alike. The next box comes when all three have answered the last.

mod bus;
mod figures;
mod sockets;

use std::path::PathBuf;

use anyhow::bail;
use bytemuck::Zeroable as _;
use messages::topics::Role;
use messages::{Action, BeltState, BoxQueue, Header, Instance, MotionOutcome, MotionReport, PlaceCommand, WireBox};
use packing::{BoxSpec, Grid, Placement};
use runtime::{Bus, Config, LogLevel};

use crate::args::{CellArgs, expected_boxes};
use crate::cell::Cell;
use crate::page::write_file;
use crate::private_bus::PrivateBus;
use bus::OnBus;
use figures::{Figures, Times};
use sockets::Peers;

/// Boxes before the measuring begins.
const WARM_UP: usize = 100;

#[derive(Debug, clap::Args)]
pub(crate) struct BenchArgs {
    #[command(flatten)]
    cell: CellArgs,
    /// Boxes to measure, after the first 100
    #[arg(long, value_name = "N", default_value_t = 1000)]
    boxes: usize,
    /// Writes the figures to this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Writes a picture of where the time of a box goes to this file
    #[arg(long, value_name = "F.svg")]
    svg: Option<PathBuf>,
}

pub(crate) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let mut config = args.cell.config()?;
    config.log.level = LogLevel::Warn;
    let boxes = expected_boxes(&mut config)?.episodes.concat();
    let private = PrivateBus::new()?;
    config.bus = private.config().clone();
    config.state.dir = config.bus.root_dir.join("state");
    let load_before = figures::load()?;
    let (times, stages) = measure(&config, &boxes, args.boxes)?;
    let figures = Figures::new(&config, &times, &stages, [load_before, figures::load()?])?;
    println!("{figures}");
    if let Some(path) = &args.json {
        write_file(path, &(serde_json::to_string_pretty(&figures)? + "\n"))?;
    }
    if let Some(path) = &args.svg {
        write_file(path, &figures.picture())?;
    }
    Ok(())
}

/// Lets all three decide the boxes, again and again until enough are measured.
fn measure(config: &Config, boxes: &[BoxSpec], wanted: usize) -> anyhow::Result<(Times, crate::latency::Latencies)> {
    let bus = Bus::join(&config.bus, Role::Perception)?;
    let mut on_bus = OnBus::new(&bus)?;
    let cell = Cell::start_without_perception(config, &[Instance::default()], &bus)?;
    let mut peers = Peers::start(&config.bus.root_dir)?;
    let mut world = World::new(Grid::new(config.container_size()?, config.container.slots)?);
    let mut times = Times::default();
    let mut placed = 0;
    for next in (0..boxes.len()).cycle().take_while(|_| !bus.is_stopping()) {
        if placed == WARM_UP + wanted {
            break;
        }
        if next == 0 {
            world.clear()?;
        }
        // A box that fits nowhere stays until a container has left for it. Only placements are measured.
        let mut action = Action::Replace;
        while action == Action::Replace {
            world.show(&boxes[next..], config.perception.upcoming)?;
            let mut decisions = [None; 3];
            for turn in 0..3 {
                let contender = (turn + placed) % 3;
                decisions[contender] = Some(match contender {
                    0 => on_bus.decide(&world.grid, &world.queue)?,
                    1 => peers.decide(&world.grid, &world.queue)?,
                    _ => peers.decide_alone(&world.grid, &world.queue)?,
                });
            }
            let [Some(first), Some(second), Some(third)] = decisions else { bail!("everybody had a turn") };
            let command = first.command;
            action = Action::from_wire(command.action)?;
            if action == Action::Place {
                placed += 1;
                if placed > WARM_UP {
                    times.record([first, second, third]);
                }
            }
            on_bus.report(first.motion(), placed > WARM_UP)?;
            peers.report([second.motion(), third.motion()])?;
            world.obey(&command, action)?;
        }
    }
    cell.stop()?;
    Ok((times, on_bus.stages))
}

/// One contender's answer to one box.
#[derive(Clone, Copy, Debug)]
struct Decision {
    command: PlaceCommand,
    /// From the box to the command [ns].
    total_ns: u64,
}

impl Decision {
    /// The arm's report that it has obeyed.
    fn motion(&self) -> MotionReport {
        let PlaceCommand { order, spec, revision, action, .. } = self.command;
        let outcome = MotionOutcome::Done.to_wire();
        MotionReport { header: Header::default(), order, box_id: spec.id, revision, action, outcome }
    }
}

/// The containers and the belt.
struct World {
    grid: Grid,
    next_container: u32,
    queue: BoxQueue,
}

impl World {
    fn new(grid: Grid) -> Self {
        let queue = BoxQueue { belt: BeltState::BoxPresent.to_wire(), ..BoxQueue::zeroed() };
        Self { next_container: grid.slots().len() as u32, grid, queue }
    }

    /// New containers everywhere.
    fn clear(&mut self) -> anyhow::Result<()> {
        (0..self.grid.slots().len() as u16).try_for_each(|slot| self.replace(slot))
    }

    fn replace(&mut self, slot: u16) -> anyhow::Result<()> {
        self.grid.replace(slot, self.next_container)?;
        self.next_container += 1;
        Ok(())
    }

    /// The first of the boxes lies at the pick position, and some more are seen.
    fn show(&mut self, boxes: &[BoxSpec], upcoming: usize) -> anyhow::Result<()> {
        let numbered = |(spec, id): (&BoxSpec, u64)| BoxSpec::new(id, spec.size_mm());
        let seen: Vec<BoxSpec> =
            boxes.iter().zip(self.queue.taken + 1..).take(1 + upcoming).map(numbered).collect::<Result<_, _>>()?;
        self.queue.revision = self.grid.revision();
        self.queue.current = WireBox::from(seen[0]);
        self.queue.write_upcoming(seen[1..].iter().copied());
        Ok(())
    }

    /// The arm has done it.
    fn obey(&mut self, command: &PlaceCommand, action: Action) -> anyhow::Result<()> {
        let placement = Placement::try_from(command.placement)?;
        match action {
            Action::Place => self.grid.place(&BoxSpec::try_from(command.spec)?, placement)?,
            Action::Replace => self.replace(placement.slot)?,
            Action::SetAside => {}
        }
        self.queue.taken += u64::from(action != Action::Replace);
        Ok(())
    }
}
