//! `commander`: turns candidate sets and decisions into one command for every box.
//!
//! Reads `packcell/candidates`, `packcell/decisions`, `packcell/motions` and `packcell/belief`; writes
//! `packcell/commands` and, after the motion, `packcell/cycles`. One runs on a bus; a second one is refused.

use clap::Parser;
use commander::{Commander, CycleLog, Deadlines};
use messages::topics::{BELIEF, CANDIDATES, COMMANDS, CYCLES, DECISIONS, MOTIONS, Role};
use runtime::{Bus, ReloadSignal, Reporter, ServiceArgs, monotonic_ns};
use tracing::info;

/// How often the dead are cleaned up after, when no box waits [ns].
const CLEANING_NS: u64 = 1_000_000_000;

/// Commands the arm, once for every box.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(flatten)]
    service: ServiceArgs,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse().service;
    let config = args.load()?;
    let mut commander = Commander::new(Deadlines::of(&config.commander), config.close_policy()?, 0);

    let bus = Bus::join(&config.bus, Role::Commander)?;
    let mut reload = ReloadSignal::catch(args, config)?;
    let mut commands = bus.publisher(&COMMANDS)?;
    let mut cycles = bus.publisher(&CYCLES)?;
    let bell = bus.bell()?;
    let mut beliefs = bus.latest(&BELIEF)?;
    let mut sets = bus.latest(&CANDIDATES)?;
    let decisions = bus.subscriber(&DECISIONS)?;
    let motions = bus.subscriber(&MOTIONS)?;
    let mut reporter = Reporter::new(&bus, "one command a box")?;
    info!("ready");

    let (mut cycle_log, mut cleaning_due_ns) = (CycleLog::default(), 0);
    while bell.wait(commander.wake_ns())? {
        if let Some(config) = reload.take() {
            commander.set_rules(Deadlines::of(&config.commander), config.close_policy()?);
        }
        while let Some(motion) = motions.receive()? {
            if let Some(report) = commander.on_motion(&motion) {
                cycle_log.record(&report);
                cycles.publish(report.stamps.observed_ns, |cycle| *cycle = report)?;
            }
        }
        if beliefs.refresh()?
            && let Some(belief) = beliefs.get()
        {
            commander.on_belief(belief);
        }
        let mut order = None;
        if sets.refresh()? {
            order = sets.get().and_then(|set| commander.on_candidates(set, monotonic_ns()));
        }
        while let Some(decision) = decisions.receive()? {
            order = order.or(commander.on_decision(&decision, monotonic_ns()));
        }
        if let Some(order) = order.or_else(|| commander.on_time(monotonic_ns())) {
            let stamp_ns = commands.publish(order.observed_ns(), |command| order.write(command))?;
            commander.on_commanded(stamp_ns);
        }
        if commander.wake_ns().is_none() && monotonic_ns() >= cleaning_due_ns {
            bus.clean_up_after_the_dead();
            cleaning_due_ns = monotonic_ns() + CLEANING_NS;
        }
        commands.greet_newcomers()?;
        cycles.greet_newcomers()?;
        reporter.report_if_due(commander.tally())?;
    }
    info!("stopped");
    Ok(())
}
